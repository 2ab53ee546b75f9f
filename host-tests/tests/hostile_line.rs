//! A part of the command `hostile-line`: whatever comes over the serial line, the firmware keeps its promises.

use host_tests::study::hostile_line::hostile_line;

/// Emulated time, minutes: enough for a run under attack.
const MINUTES: f64 = 3.2;

#[test]
fn a_hostile_line_breaks_no_promise() {
    let siege = hostile_line(1, MINUTES).unwrap_or_else(|error| panic!("{error:#}"));
    assert_eq!(siege.breaches, [] as [String; 0]);
    assert_eq!((siege.lost, siege.resets, siege.panics), (0, 0, 0));
    assert!(siege.attacks.iter().filter(|count| **count > 0).count() > 3, "{:?}", siege.attacks);
    assert!(siege.frames > 1000 && siege.answers > 500 && siege.urgent > 10 && siege.judged[0] > 0, "{siege:?}");
}
