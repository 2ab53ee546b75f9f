//! A part of the command `chaos`: nothing moves without authority, nothing wrong is accepted, and nothing panics.

use host_tests::study::chaos::{Chaos, chaos};

fn check(chaos: &Chaos) {
    assert_eq!(chaos.breaches, [] as [String; 0]);
    // The steps reach every state in which axes move or come to rest.
    for state in ["StandBy", "AwaitStill", "Turn", "Dwell", "Stopping", "Parking", "Parked", "Stopped", "Stranded"] {
        assert!(chaos.states.contains_key(state), "{state}: {:?}", chaos.states);
    }
    assert!(chaos.moves > 100 && chaos.power_ups > 2 && chaos.judged > 0, "{chaos:?}");
}

#[test]
fn chaos_breaks_no_promise_in_double_precision() {
    check(&chaos::<f64>(1, 400_000));
}

#[test]
fn chaos_breaks_no_promise_in_single_precision() {
    check(&chaos::<f32>(2, 400_000));
}
