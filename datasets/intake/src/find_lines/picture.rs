//! Picture for checking the lines of a flight.

use figures::{FlightPart, FlightPicture, TimePanel, flight_png, flight_svg};
use schemas::Fault;

use super::{LineDetection, LinePattern, MotionClass};

/// Classes of samples, in addition to the kinds of lines.
const SLOW: usize = 0;
const BETWEEN: usize = 1;
const MANOEUVRE: usize = 2 + LinePattern::ALL.len();

/// Names and colours of the stretches between lines, of the lines, and of the manoeuvres on the lines. The colours are
/// distinguishable without red-green vision [Wong 2011, Nature Methods 8, 441].
const KINDS: [(&str, [u8; 3]); 9] = [
    ("on the ground, or slow", [205, 205, 205]),
    ("turn, or too short", [140, 140, 140]),
    ("line", [0, 114, 178]),
    ("tie line", [86, 180, 233]),
    ("calibration box", [230, 159, 0]),
    ("cloverleaf", [204, 121, 167]),
    ("figure of eight", [0, 158, 115]),
    ("circle", [138, 109, 59]),
    ("pitch, roll or yaw manoeuvre", [213, 94, 0]),
];
const ANGLES: [(&str, [u8; 3]); 3] = [("roll", [213, 94, 0]), ("pitch", [0, 114, 178]), ("yaw", [0, 158, 115])];

/// The picture as an SVG file.
///
/// # Errors
/// Fails for a flight of fewer than two times.
pub fn svg(title: &str, found: &LineDetection) -> Result<String, Fault> {
    drawn(title, found, &|picture| flight_svg(picture))
}

/// The picture as a PNG file.
///
/// # Errors
/// Returns the errors of [`svg`]. Also fails for a width that is out of range.
pub fn png(title: &str, found: &LineDetection, width_px: usize) -> Result<Vec<u8>, Fault> {
    drawn(title, found, &|picture| flight_png(picture, width_px))
}

fn index(kind: LinePattern) -> usize {
    2 + LinePattern::ALL.iter().position(|k| *k == kind).unwrap_or(0)
}

fn drawn<T>(title: &str, found: &LineDetection, draw: &dyn Fn(&FlightPicture) -> Result<T, Fault>) -> Result<T, Fault> {
    let motion = &found.motion;
    let mut kind: Vec<usize> =
        found.parts.parts.iter().map(|part| if *part == MotionClass::Slow { SLOW } else { BETWEEN }).collect();
    let mut parts = vec![];
    for line in &found.lines {
        kind.iter_mut().take(line.rows.end).skip(line.rows.start).for_each(|k| *k = index(line.kind));
        parts.push(FlightPart { name: line.name.clone(), kind: index(line.kind), time: found.times_s(line) });
    }
    let busy =
        found.parts.parts.iter().zip(&mut kind).filter(|(part, k)| **part == MotionClass::Manoeuvre && **k > BETWEEN);
    busy.for_each(|(_, k)| *k = MANOEUVRE);
    let course: Vec<f64> = motion.course_deg.iter().map(|course| course.rem_euclid(360.0)).collect();
    let power: Vec<(&str, [u8; 3], &[f64])> =
        ANGLES.iter().zip(&found.parts.power_deg).map(|((name, colour), x)| (*name, *colour, x.as_slice())).collect();
    let black = [26, 26, 26];
    let panels = [
        TimePanel { label: "course (deg)", turn: Some(360.0), lines: vec![("", black, &course)] },
        TimePanel { label: "height (m)", turn: None, lines: vec![("", black, &motion.alt_m)] },
        TimePanel { label: "speed (m/s)", turn: None, lines: vec![("", black, &motion.speed_mps)] },
        TimePanel { label: "attitude (deg rms)", turn: None, lines: power },
    ];
    draw(&FlightPicture {
        title,
        time: &motion.tt_s,
        time_label: "tt, seconds past midnight UTC",
        east_m: &motion.east_m,
        north_m: &motion.north_m,
        kind: &kind,
        kinds: &KINDS,
        parts: &parts,
        panels: &panels,
    })
}
