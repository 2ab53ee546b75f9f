//! What the paper states about its simulation and its instrument, beside what is inferred and what the page uses.

use maud::{Markup, html};

/// A condition: what it is about; what the paper states; what is inferred from it, with the reason; what the page uses.
type Condition = [&'static str; 4];

const CONDITIONS: [Condition; 12] = [
    ["sampling", "200 Hz (Table 2)", "", "200 Hz"],
    [
        "random error of the gyros",
        "0.005 deg/h",
        "bias or noise is not stated",
        "a bias in the unit named real, zero in those of Tables 1 and 3",
    ],
    [
        "random error of the accelerometers",
        "30 (unit lost)",
        "30 ug, as Table 2 has; bias or noise is not stated",
        "white noise of 30 ug in each sample; a bias too in the unit named real",
    ],
    [
        "measurement noise of the gyros",
        "0.2 (unit lost), to be ignored against the rotation",
        "arcsec/s in each sample, because it is compared with the rate of rotation",
        "white noise of 0.2 arcsec/s in each sample",
    ],
    [
        "measurement noise of the accelerometers",
        "0.3 (unit lost)",
        "ug or mg: smaller than or much larger than the random error, so not usable",
        "not used; the 30 ug are",
    ],
    [
        "angle of the rotation mechanism",
        "error 0.5 (unit lost)",
        "arcsec; constant or random is not stated",
        "0.5 arcsec, a new random value for each stop and axis",
    ],
    [
        "rate of the rotation mechanism",
        "error 0.7 (unit lost; per second in Table 2)",
        "arcsec/s, random",
        "0.7 arcsec/s in each sample while an axis turns",
    ],
    ["rate of rotation", "20 deg/s (72,000 arcsec/s)", "", "20 deg/s"],
    [
        "site",
        "114.19659, 30.93041 (units lost)",
        "longitude and latitude in degrees",
        "30.93041 deg N; the longitude has no effect",
    ],
    [
        "scheme",
        "outer axis both ways, stops at multiples of -90 deg; inner axis to -90 deg; outer axis both ways; inner axis both \
         ways, in which it cannot turn by -270 deg; twice; 200 s for every stop",
        "the inner axis is z, and the ways back reverse the ways out: then three, four and five parameters are activated, \
         as the text says",
        "18 moves and 19 stops a period",
    ],
    [
        "heading",
        "needed in its Equation (12); no source stated",
        "from the gyros at rest",
        "by gyrocompassing at the first stop",
    ],
    [
        "Kalman filters",
        "a covariance, a dimension of 12, and one setting more for each of the two filters (symbols and numbers lost)",
        "P0 or Q, and R; no numbers can be inferred",
        "P0, Q and R of the chapter theory (rins guide theory)",
    ],
];

/// Table 2 of the paper.
const TABLE_2: [[&str; 3]; 5] = [
    ["Sampling frequency", "200 Hz", "200 Hz"],
    ["Gyro bias stability", "0.005 °/h", "0.005 deg/h"],
    ["Accelerometers bias stability", "30 μg", "30 ug"],
    ["Rotation angle accuracy", "0.5 (unit lost)", "0.5 arcsec"],
    ["Rotation velocity accuracy", "0.7 /s (unit of angle lost)", "0.7 arcsec/s"],
];

/// The conditions of the simulation; `motion` describes the scheme of this page.
pub fn conditions(motion: &str) -> Markup {
    html! {
        div.scroll { table id="conditions-stated" {
            thead { tr { th.text {} th.text { "stated in the paper" } th.text { "inferred" } th.text { "used here" } } }
            tbody {
                @for [what, stated, inferred, used] in &CONDITIONS {
                    tr { th.text { (what) } td.wide { (stated) } td.wide { (inferred) } td.wide { (used) } }
                }
                tr { th.text { "motion of this page" } td.wide {} td.wide {} td.wide { (motion) } }
            }
        } }
    }
}

/// Table 2 with its five numbers.
pub fn table_2() -> Markup {
    html! {
        div.scroll { table id="table-2" {
            thead { tr { th.text { "characteristics" } th.text { "description in the paper" } th.text { "read here as" } } }
            tbody { @for [what, stated, read] in &TABLE_2 { tr { th.text { (what) } td.text { (stated) } td.text { (read) } } } }
        } }
    }
}
