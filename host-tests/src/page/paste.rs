//! The correction as source text in several languages.

use crate::result::report::CorrectionReport;
use std::fmt::Write;

/// Notation of the correction in a language.
struct Dialect {
    name: &'static str,
    comment: &'static str,
    head: &'static str,
    vector: fn(&str, &[f64; 3]) -> String,
    matrix: fn(&str, &[[f64; 3]; 3]) -> String,
    scalar: fn(&str, f64) -> String,
    apply: &'static str,
}

const DIALECTS: [Dialect; 4] = [
    Dialect {
        name: "Rust",
        comment: "//",
        head: "",
        vector: |name, v| format!("pub const {}: [f64; 3] = [{}];\n", name.to_uppercase(), row(v)),
        matrix: |name, m| declared(&format!("pub const {}: [[f64; 3]; 3]", name.to_uppercase()), ["[", "]"], m),
        scalar: |name, x| format!("pub const {}: f64 = {x:e};\n", name.to_uppercase()),
        apply: "",
    },
    Dialect {
        name: "C",
        comment: "//",
        head: "",
        vector: |name, v| format!("static const double {name}[3] = {{{}}};\n", row(v)),
        matrix: |name, m| declared(&format!("static const double {name}[3][3]"), ["{", "}"], m),
        scalar: |name, x| format!("static const double {name} = {x:e};\n"),
        apply: "",
    },
    Dialect {
        name: "Python",
        comment: "#",
        head: "import numpy as np\n",
        vector: |name, v| format!("{name} = np.array([{}])\n", row(v)),
        matrix: |name, m| format!("{name} = np.array([\n{}])\n", rows(m, "    [", "],\n")),
        scalar: |name, x| format!("{name} = {x:e}\n"),
        apply: "f_s = force_matrix_sa @ (f_a - accel_bias_a)\nw_s = rate_matrix_sg @ (w_g - gyro_bias_g)\n",
    },
    Dialect {
        name: "MATLAB",
        comment: "%",
        head: "",
        vector: |name, v| format!("{name} = [{}].';\n", row(v)),
        matrix: |name, m| format!("{name} = [\n{}];\n", rows(m, "    ", ";\n")),
        scalar: |name, x| format!("{name} = {x:e};\n"),
        apply: "f_s = force_matrix_sa * (f_a - accel_bias_a);\nw_s = rate_matrix_sg * (w_g - gyro_bias_g);\n",
    },
];

fn row(values: &[f64; 3]) -> String {
    values.map(|value| format!("{value:.15e}")).join(", ")
}

fn rows(matrix: &[[f64; 3]; 3], open: &str, close: &str) -> String {
    matrix.iter().map(|values| format!("{open}{}{close}", row(values))).collect()
}

/// A declaration of a matrix in brackets.
fn declared(what: &str, [open, close]: [&str; 2], matrix: &[[f64; 3]; 3]) -> String {
    format!("{what} = {open}\n{}{close};\n", rows(matrix, &format!("    {open}"), &format!("{close},\n")))
}

/// Name of each language, and the correction in this language.
pub fn snippets(correction: &CorrectionReport) -> impl Iterator<Item = (&'static str, String)> + '_ {
    DIALECTS.iter().map(|dialect| (dialect.name, snippet(dialect, correction)))
}

fn snippet(dialect: &Dialect, correction: &CorrectionReport) -> String {
    let mut text = String::from(dialect.head);
    let mut note = |line: &str, part: String| {
        // Writing to a string cannot fail.
        let _ = write!(text, "{} {line}\n{part}", dialect.comment);
    };
    note(
        "m/s^2: f_s = force_matrix_sa (f_a - accel_bias_a)",
        (dialect.vector)("accel_bias_a", &correction.accel_bias_a),
    );
    note("by rows", (dialect.matrix)("force_matrix_sa", &correction.force_matrix_sa));
    note("rad/s: w_s = rate_matrix_sg (w_g - gyro_bias_g)", (dialect.vector)("gyro_bias_g", &correction.gyro_bias_g));
    note("by rows", (dialect.matrix)("rate_matrix_sg", &correction.rate_matrix_sg));
    note(
        "from the rotation frame r to the IMU frame s: v_s = rot_sr v_r",
        (dialect.matrix)("rot_sr", &correction.rot_sr),
    );
    let d = correction.axis_nonperpendicularity_rad;
    note(
        "rad: the inner axis in r at zero angles is (sin d, 0, cos d)",
        (dialect.scalar)("axis_nonperpendicularity", d),
    );
    text + dialect.apply
}
