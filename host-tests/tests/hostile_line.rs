//! A part of the command `hostile-line`: whatever comes over the serial line, the firmware keeps its promises.

use host_tests::study::hostile_line::hostile_line;

/// Emulated time, minutes. A run under attack begins, but it does not end in this time; the command has runs that do.
const MINUTES: f64 = 0.6;

#[test]
fn a_hostile_line_breaks_no_promise() {
    let siege = hostile_line(1, MINUTES).unwrap_or_else(|error| panic!("{error:#}"));
    assert_eq!(siege.breaches, [] as [String; 0]);
    assert_eq!((siege.lost, siege.resets, siege.panics), (0, 0, 0));
    assert!(siege.attacks.iter().filter(|count| **count > 0).count() >= 3, "{:?}", siege.attacks);
    assert!(siege.frames > 500 && siege.answers > 50 && siege.urgent > 5, "{siege:?}");
}
