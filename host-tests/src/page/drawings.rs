//! Drawings of frames, method, instrument and procedure, in place of the paper's Figures 1 to 4, 12 and 13, which are not
//! available to this software.

use maud::{Markup, html};
use rins_selfcal::base::units::DEG;
use rins_selfcal::scheme::Scheme;

/// A box with lines of text; its left upper corner and its size, SVG units.
struct Block<'a> {
    at: [i32; 2],
    size: [i32; 2],
    lines: &'a [&'a str],
}

const LINE: i32 = 17;

fn drawing(id: &str, size: [i32; 2], caption: &str, content: &Markup) -> Markup {
    html! {
        figure id=(id) {
            svg viewBox={ "0 0 " (size[0]) " " (size[1]) } xmlns="http://www.w3.org/2000/svg" font-family="sans-serif" font-size="13" fill="currentColor" {
                defs { marker id={ (id) "-tip" } viewBox="0 0 10 10" refX="9" refY="5" markerWidth="8" markerHeight="8" orient="auto-start-reverse" {
                    path d="M0 0 L10 5 L0 10 z" {}
                } }
                (content)
            }
            figcaption { (caption) }
        }
    }
}

fn block(Block { at: [x, y], size: [width, height], lines }: &Block) -> Markup {
    let top = y + (height - LINE * (lines.len() as i32 - 1)) / 2 + 5;
    html! {
        rect x=(x) y=(y) width=(width) height=(height) rx="4" fill="none" stroke="currentColor" {}
        @for (line, text) in (0..).zip(*lines) {
            text x=(x + width / 2) y=(top + LINE * line) text-anchor="middle" { (text) }
        }
    }
}

fn arrow(id: &str, from: [i32; 2], to: [i32; 2]) -> Markup {
    html! {
        line x1=(from[0]) y1=(from[1]) x2=(to[0]) y2=(to[1]) stroke="currentColor" marker-end={ "url(#" (id) "-tip)" } {}
    }
}

fn label(at: [i32; 2], text: &str) -> Markup {
    html! { text x=(at[0]) y=(at[1]) { (text) } }
}

/// An axis from the origin of a frame with its name; dashed for the axes of a sensor.
fn axis(id: &str, origin: [i32; 2], to: [i32; 2], name: &str, is_sensor: bool) -> Markup {
    let dashes = if is_sensor { "6 4" } else { "none" };
    let at = [to[0] + if to[0] < origin[0] { -28 } else { 6 }, to[1] + if to[1] > origin[1] { 16 } else { -4 }];
    html! {
        line x1=(origin[0]) y1=(origin[1]) x2=(to[0]) y2=(to[1]) stroke="currentColor" stroke-dasharray=(dashes) marker-end={ "url(#" (id) "-tip)" } {}
        (label(at, name))
    }
}

/// Figure 1: the IMU frame with the axes of the accelerometers and of the gyros. (M1)
pub fn frames_of_sensors() -> Markup {
    let id = "figure-1";
    let frame = |x: i32| {
        html! {
            (axis(id, [x, 190], [x + 190, 190], "y s", false))
            (axis(id, [x, 190], [x, 30], "z s", false))
            (axis(id, [x, 190], [x - 110, 270], "x s", false))
        }
    };
    let content = html! {
        (frame(170))
        (axis(id, [170, 190], [352, 222], "y a", true))
        (axis(id, [170, 190], [222, 42], "z a", true))
        (label([54, 286], "= x a"))
        (label([225, 262], "Sayz, in the x s-y s plane"))
        (label([235, 80], "Sazx, Sazy"))
        (label([120, 330], "(a) accelerometers"))
        (frame(620))
        (axis(id, [620, 190], [802, 222], "y g", true))
        (axis(id, [620, 190], [672, 42], "z g", true))
        (axis(id, [620, 190], [538, 292], "x g", true))
        (label([690, 262], "Sgyx, Sgyz"))
        (label([685, 80], "Sgzx, Sgzy"))
        (label([560, 292], "Sgxy, Sgxz"))
        (label([580, 330], "(b) gyros"))
    };
    drawing(
        id,
        [960, 345],
        "Figure 1: the IMU frame s (solid) is defined by the accelerometers: x s is x a, and y a is in the x s-y s plane. \
         Three angles remain for the accelerometers, six for the gyros (dashed; angles enlarged).",
        &content,
    )
}

/// Figure 2: the IMU frame and the frame of the rotation mechanism at the start. (M2)
pub fn frames_of_mounting() -> Markup {
    let id = "figure-2";
    let content = html! {
        (axis(id, [330, 180], [540, 180], "x r0, outer axis", false))
        (axis(id, [330, 180], [330, 20], "z r0, inner axis", false))
        (axis(id, [330, 180], [440, 90], "y r0", false))
        (axis(id, [330, 180], [532, 214], "x s0", true))
        (axis(id, [330, 180], [362, 36], "z s0", true))
        (axis(id, [330, 180], [462, 122], "y s0", true))
        (label([600, 90], "rot s0r0 = exp(-[theta x])"))
        (label([600, 112], "theta = (alpha, beta, gamma)"))
        (label([600, 134], "= I - [theta x] to first order"))
    };
    drawing(
        id,
        [960, 240],
        "Figure 2: at the start, the IMU frame s0 differs from the frame r0 of the rotation mechanism by three mounting \
         angles (enlarged).",
        &content,
    )
}

/// Figure 3: the structure of the method.
pub fn structure() -> Markup {
    let id = "figure-3";
    let blocks = [
        Block { at: [20, 30], size: [170, 50], lines: &["accelerometers", "at the stops"] },
        Block { at: [20, 120], size: [170, 50], lines: &["angles of the", "rotation mechanism"] },
        Block { at: [20, 210], size: [170, 50], lines: &["gyros while turning"] },
        Block { at: [20, 300], size: [170, 50], lines: &["rates of the", "rotation mechanism"] },
        Block {
            at: [290, 60],
            size: [230, 70],
            lines: &["first observation (B11):", "the attitude of the vehicle", "does not change"],
        },
        Block {
            at: [290, 235],
            size: [230, 70],
            lines: &["second observation (B13):", "rate of the gyros, of the earth", "and of the mechanism"],
        },
        Block { at: [610, 60], size: [150, 70], lines: &["Kalman filter,", "period one"] },
        Block { at: [610, 235], size: [150, 70], lines: &["Kalman filter,", "period two"] },
        Block { at: [820, 60], size: [130, 70], lines: &["Sayz Sazx Sazy", "alpha beta gamma"] },
        Block { at: [820, 235], size: [130, 70], lines: &["Sgxy Sgxz Sgyx", "Sgyz Sgzx Sgzy"] },
    ];
    let arrows = [
        ([190, 55], [288, 85]),
        ([190, 145], [288, 110]),
        ([190, 150], [288, 252]),
        ([190, 235], [288, 270]),
        ([190, 325], [288, 290]),
        ([520, 95], [608, 95]),
        ([520, 270], [608, 270]),
        ([760, 95], [818, 95]),
        ([760, 270], [818, 270]),
        ([840, 130], [480, 233]),
    ];
    let content = html! {
        @for shown in &blocks { (block(shown)) }
        @for (from, to) in arrows { (arrow(id, from, to)) }
        (label([700, 192], "mounting angles and"))
        (label([700, 209], "levelled attitude, (B12)"))
    };
    drawing(id, [960, 365], "Figure 3: structure of the paper's method.", &content)
}

/// Figure 4: one period of the scheme, with the angles after each move.
pub fn scheme(scheme: &Scheme) -> Markup {
    let id = "figure-4";
    let (left, step) = (70, 45);
    let x = |stop: usize| left + step * stop as i32;
    let deg = |rad: f64| (rad / DEG).round() as i32;
    let mut outer = vec![0];
    let mut inner = vec![0];
    for leg in &scheme.legs {
        outer.push(deg(leg.outer_rad));
        inner.push(deg(leg.inner_rad));
    }
    let low = outer.iter().chain(&inner).copied().min().unwrap_or(0).min(-90);
    let y = |top: i32, angle: i32| top + 110 * angle / low;
    let line = |top: i32, angles: &[i32]| {
        let points = angles.iter().enumerate().map(|(stop, angle)| format!("{},{}", x(stop), y(top, *angle)));
        points.collect::<Vec<_>>().join(" ")
    };
    let content = html! {
        @for (top, name, angles) in [(40, "outer axis, deg", &outer), (210, "inner axis, deg", &inner)] {
            (label([8, top - 20], name))
            @for angle in (low..=0).step_by(90) {
                text x=(left - 12) y=(y(top, angle) + 4) text-anchor="end" { (angle) }
                line x1=(left) x2=(x(angles.len() - 1)) y1=(y(top, angle)) y2=(y(top, angle)) stroke="currentColor" stroke-opacity="0.2" {}
            }
            polyline points=(line(top, angles)) fill="none" stroke="currentColor" stroke-width="2" {}
            @for (stop, angle) in angles.iter().enumerate() { circle cx=(x(stop)) cy=(y(top, *angle)) r="3" {} }
        }
        @for stop in 0..outer.len() { text x=(x(stop)) y="350" text-anchor="middle" { (stop) } }
        (label([left, 370], "number of the stop; a move between each two"))
    };
    drawing(
        id,
        [960, 380],
        "Figure 4: one period of rotation in the self-calibration scheme; the angles at each stop.",
        &content,
    )
}

/// Figure 12: the parts of a dual-axis RINS.
pub fn instrument() -> Markup {
    let id = "figure-12";
    let blocks = [
        Block { at: [20, 40], size: [720, 270], lines: &[] },
        Block { at: [150, 70], size: [460, 210], lines: &[] },
        Block { at: [300, 105], size: [160, 110], lines: &["IMU", "3 fiber gyros", "3 quartz", "accelerometers"] },
        Block { at: [32, 130], size: [106, 60], lines: &["outer motor", "and encoder"] },
        Block { at: [300, 230], size: [160, 34], lines: &["inner motor, encoder"] },
    ];
    let content = html! {
        @for shown in &blocks { (block(shown)) }
        (label([30, 300], "case, fixed to the vehicle: b-frame"))
        (label([160, 272], "outer gimbal"))
        (label([466, 125], "inner gimbal: r-frame"))
        (axis(id, [610, 160], [760, 160], "outer axis, x r0", false))
        (axis(id, [380, 105], [380, 22], "inner axis, z r", false))
    };
    drawing(
        id,
        [960, 325],
        "Figure 12: internal structure of a dual-axis RINS with fiber gyros and quartz accelerometers, as far as the text \
         describes it.",
        &content,
    )
}

/// Figure 13: the procedure of the experiment.
pub fn procedure(stop_s: f64) -> Markup {
    let id = "figure-13";
    let stops = format!("stops of {stop_s} s: (B11)");
    let first = ["period one,", &stops];
    let blocks = [
        Block { at: [20, 40], size: [150, 60], lines: &["RINS at rest", "on a turntable"] },
        Block { at: [220, 40], size: [180, 60], lines: &first },
        Block { at: [450, 40], size: [180, 60], lines: &["period two,", "while turning: (B13)"] },
        Block { at: [680, 40], size: [150, 60], lines: &["twelve", "installation errors"] },
        Block { at: [220, 160], size: [180, 60], lines: &["separating method [11]:", "nine angles"] },
        Block { at: [450, 160], size: [180, 60], lines: &["separating method [13]:", "three mounting angles"] },
        Block { at: [680, 160], size: [150, 60], lines: &["reference"] },
        Block { at: [850, 100], size: [100, 60], lines: &["difference,", "Table 3"] },
    ];
    let arrows = [
        ([170, 70], [218, 70]),
        ([400, 70], [448, 70]),
        ([630, 70], [678, 70]),
        ([130, 100], [218, 185]),
        ([400, 190], [448, 190]),
        ([630, 190], [678, 190]),
        ([830, 70], [875, 98]),
        ([830, 190], [875, 162]),
    ];
    let content = html! {
        @for shown in &blocks { (block(shown)) }
        @for (from, to) in arrows { (arrow(id, from, to)) }
    };
    drawing(id, [960, 240], "Figure 13: flow of the experiment and of its comparison.", &content)
}
