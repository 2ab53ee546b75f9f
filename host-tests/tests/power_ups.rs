//! A part of the command `power-ups`: no axis leaves its travel.

use host_tests::study::power_ups::power_ups;

#[test]
fn no_axis_leaves_its_travel_at_200_power_ups() {
    let all = power_ups(1, 200);
    assert_eq!(all.breaches, [] as [String; 0]);
    // All that can happen does happen.
    assert!(all.moved > 50 && all.cut > 20 && all.refused > 20 && all.confirmed > 10, "{all:?}");
}
