//! Columns that contradict each other: an INS far from the truth, positions that do not move with the velocities,
//! heights that agree only in other units.
//!
//! Only impossible values are reported: a limit is far exceeded, or columns agree only in another unit.

use arrow_array::{RecordBatch, cast::AsArray, types::Float64Type};
use numerics::{angle::wrap_deg, regression::statistics};
use schemas::{Fault, plausible::shown};

use self::motion::{chords, length, mean_speed};
use super::{
    clock_digits,
    finding::{FileColumns, Finding, FindingKind},
};

mod motion;
#[cfg(test)]
mod tests;

/// The largest plausible error of an INS.
const INS_KM: f64 = 500.0;
/// A change of position from one sample to the next is impossible if it exceeds this distance and implies a higher
/// speed than this.
const JUMP_KM: f64 = 100.0;
const JUMP_MPS: f64 = 1_000.0;
/// Below this mean speed the noise of positions gives no information on velocities.
const MOVING_MPS: f64 = 3.0;
/// Maximum number of rows for a median.
const SOME_ROWS: usize = 2_000;

/// All contradictions of a line, one for each mistake; `faulty` columns are skipped.
pub fn contradictions(batch: &RecordBatch, faulty: &[String], origins: &FileColumns) -> Vec<(Fault, Finding)> {
    let line = ConsistencyLine { batch, faulty, origins };
    let positions = ins_distance(&line)
        .or_else(|| radians_at_the_equator(&line, TRUTH))
        .or_else(|| radians_at_the_equator(&line, INS))
        .or_else(|| motion::horizontal(&line))
        .or_else(|| jump(&line));
    let mut found: Vec<(Fault, Finding)> = positions.into_iter().collect();
    found.extend(motion::ground_speed(&line));
    found.extend(clock(&line));
    found.extend(heights(&line));
    found.extend([TRUTH, INS].into_iter().find_map(|set| motion::vertical(&line, set)));
    found.extend([TRUTH, INS].into_iter().filter_map(|set| attitude(&line, set)));
    found.extend(specific_force(&line));
    found
}

/// The columns of a position with its velocity and heading.
#[derive(Clone, Copy)]
struct MotionColumns {
    lat: &'static str,
    lon: &'static str,
    alt: &'static str,
    vn: &'static str,
    ve: &'static str,
    vd: &'static str,
    yaw: &'static str,
}

const TRUTH: MotionColumns =
    MotionColumns { lat: "lat", lon: "lon", alt: "alt", vn: "vn", ve: "ve", vd: "vd", yaw: "yaw" };
const INS: MotionColumns = MotionColumns {
    lat: "ins_lat",
    lon: "ins_lon",
    alt: "ins_alt",
    vn: "ins_vn",
    ve: "ins_ve",
    vd: "ins_vd",
    yaw: "ins_yaw",
};

struct ConsistencyLine<'a> {
    batch: &'a RecordBatch,
    faulty: &'a [String],
    origins: &'a FileColumns,
}

impl<'a> ConsistencyLine<'a> {
    fn get(&self, name: &str) -> Option<&'a [f64]> {
        if self.faulty.iter().any(|f| f == name) {
            return None;
        }
        let array = self.batch.column_by_name(name)?.as_primitive_opt::<Float64Type>()?;
        Some(array.values())
    }

    fn contradiction(&self, at: (&str, usize, f64, &str), n: usize, what: String, help: &str) -> (Fault, Finding) {
        let (column, row, value, unit) = at;
        let help = format!("{help}; `accept = [\"range\"]` accepts the values unchanged");
        let fault = Fault::data(what).in_column(column).in_row(row as u64).help(help);
        (fault, Finding::new(column, FindingKind::Inconsistent, n, row, value, unit))
    }

    fn in_radians(&self, set: MotionColumns) -> String {
        format!("the values are probably in radians: {}", self.origins.units(&[set.lat, set.lon], "rad"))
    }
}

/// The median of the values; NaN without values.
fn median(mut values: Vec<f64>) -> f64 {
    statistics::median(&mut values)
}

/// Whether all values could be angles in radians, of magnitudes up to `most`.
fn could_be_radians(x: &[f64], most: f64) -> bool {
    x.iter().all(|x| x.is_nan() || x.abs() <= most)
}

fn both_could_be_radians(lat: &[f64], lon: &[f64]) -> bool {
    use std::f64::consts::{FRAC_PI_2, TAU};
    could_be_radians(lat, FRAC_PI_2) && could_be_radians(lon, TAU)
}

/// Great-circle distance on a sphere.
fn distance_km(a: (f64, f64), b: (f64, f64)) -> f64 {
    let (lat1, lat2) = (a.0.to_radians(), b.0.to_radians());
    let half = |d: f64| (d / 2.0).sin().powi(2);
    let h = half(lat2 - lat1) + lat1.cos() * lat2.cos() * half((b.1 - a.1).to_radians());
    2.0 * 6371.0 * h.sqrt().min(1.0).asin()
}

/// Fault of clock times written as digits, `hhmmss.s`, instead of seconds.
fn clock(line: &ConsistencyLine) -> Option<(Fault, Finding)> {
    let tt = line.get("tt")?;
    let row = clock_digits::minute_after(tt)?;
    let help = format!(
        "read the column through a mapping: `time = {{ from = [{:?}], clock = \"text\", format = ... }}`, where the \
         format is {}",
        line.origins.name("tt"),
        clock_digits::formats(tt)
    );
    Some(line.contradiction(("tt", row, tt[row], "s"), tt.len(), clock_digits::WHAT.to_owned(), &help))
}

/// Fault of an INS that is impossibly far from the truth.
fn ins_distance(line: &ConsistencyLine) -> Option<(Fault, Finding)> {
    let (lat, lon) = (line.get("lat")?, line.get("lon")?);
    let (ins_lat, ins_lon) = (line.get("ins_lat")?, line.get("ins_lon")?);
    let far = |i: &usize| {
        let (a, b) = ((lat[*i], lon[*i]), (ins_lat[*i], ins_lon[*i]));
        // If the differences of the two coordinates add up to less than 3 degrees, the distance is below the limit, and
        // no trigonometric functions are evaluated.
        let (north, east) = ((a.0 - b.0).abs(), (a.1 - b.1).abs());
        north + east >= 3.0 && distance_km(a, b) > INS_KM
    };
    let first = (0..lat.len()).find(far)?;
    let n = (first..lat.len()).filter(far).count();
    let (truth, ins) = ((lat[first], lon[first]), (ins_lat[first], ins_lon[first]));
    let apart = distance_km(truth, ins);
    let close = |a: (f64, f64), b: (f64, f64)| distance_km(a, b) < 50.0;
    let turned = |p: (f64, f64)| (p.0.to_degrees(), p.1.to_degrees());
    let (set, help) = if both_could_be_radians(lat, lon) && close(turned(truth), ins) {
        (TRUTH, line.in_radians(TRUTH))
    } else if both_could_be_radians(ins_lat, ins_lon) && close(truth, turned(ins)) {
        (INS, line.in_radians(INS))
    } else if close((truth.0, -truth.1), ins) {
        (INS, "one of the longitudes is positive to the west; change its sign".to_owned())
    } else if close((truth.1, truth.0), ins) {
        (INS, "latitude and longitude of one position are swapped; use `rename`".to_owned())
    } else if truth == (0.0, 0.0) {
        (TRUTH, "loggers write 0, 0 without a fix; leave these cells empty".to_owned())
    } else {
        (INS, "correct the file".to_owned())
    };
    let what = format!(
        "the INS at {}, {} deg is {} km from the position {}, {} deg, more than the limit of {INS_KM} km",
        shown(ins.0),
        shown(ins.1),
        shown(apart.round()),
        shown(truth.0),
        shown(truth.1)
    );
    let column = if set.lat == TRUTH.lat { (set.lat, first, truth.0, "deg") } else { (set.lat, first, ins.0, "deg") };
    Some(line.contradiction(column, n, what, &help))
}

fn round(x: f64) -> f64 {
    (x * 100.0).round() / 100.0
}

/// Fault of positions that are in radians: they lie within a few degrees of 0, 0 and move slowly. That area is open
/// ocean, where no aircraft flies so slowly.
fn radians_at_the_equator(line: &ConsistencyLine, set: MotionColumns) -> Option<(Fault, Finding)> {
    let (tt, lat, lon) = (line.get("tt")?, line.get(set.lat)?, line.get(set.lon)?);
    if !both_could_be_radians(lat, lon) {
        return None;
    }
    let all = chords([tt, lat, lon], None, motion::CHORD_S);
    let speed = mean_speed(&all, |c| c.moved);
    // A stationary aircraft does not indicate a wrong unit. If positions in radians are read as degrees, a speed
    // of 290 m/s appears as 5 m/s.
    if all.len() < 3 || !(0.05..5.0).contains(&speed) {
        return None;
    }
    let row = all.first().map_or(0, |c| c.row);
    let what = format!(
        "the position {}, {} deg lies in the Gulf of Guinea and moves at {} m/s; if it is in radians, it is {}, {} \
         deg, and moves at about {} m/s",
        shown(lat[row]),
        shown(lon[row]),
        shown(round(speed)),
        shown(lat[row].to_degrees()),
        shown(lon[row].to_degrees()),
        shown(speed.to_degrees().round())
    );
    Some(line.contradiction((set.lat, row, lat[row], "deg"), lat.len(), what, &line.in_radians(set)))
}

/// Fault of a position that jumps farther than any aircraft can fly.
fn jump(line: &ConsistencyLine) -> Option<(Fault, Finding)> {
    let (tt, lat, lon) = (line.get("tt")?, line.get("lat")?, line.get("lon")?);
    let mut before: Option<usize> = None;
    for i in 0..tt.len() {
        if !(lat[i].is_finite() && lon[i].is_finite() && tt[i].is_finite()) {
            continue;
        }
        let Some(last) = before.replace(i) else { continue };
        // If both differences are below half a degree, the jump is below the limit, and no trigonometric functions are
        // evaluated.
        if (lat[i] - lat[last]).abs() < 0.5 && (lon[i] - lon[last]).abs() < 0.5 {
            continue;
        }
        let (km, seconds) = (distance_km((lat[last], lon[last]), (lat[i], lon[i])), tt[i] - tt[last]);
        if km > JUMP_KM && km * 1e3 > JUMP_MPS * seconds {
            let what = format!("the position jumps by {} km within {} s", shown(km.round()), shown(round(seconds)));
            let zero = |k: usize| lat[k] == 0.0 && lon[k] == 0.0;
            let help = if zero(i) || zero(last) {
                "loggers write 0, 0 without a fix; leave these cells empty"
            } else {
                "correct the file"
            };
            return Some(line.contradiction(("lat", i, lat[i], "deg"), 1, what, help));
        }
    }
    None
}

/// Pairs of heights that differ by at most a few hundred metres if both have the same unit.
const HEIGHTS: [(&str, &str); 3] = [("alt", "ins_alt"), ("alt", "msl"), ("alt", "baro")];

/// Heights that agree only if one of them is in feet.
fn heights(line: &ConsistencyLine) -> Option<(Fault, Finding)> {
    const FOOT: f64 = 0.3048;
    for (one, other) in HEIGHTS {
        let (Some(a), Some(b)) = (line.get(one), line.get(other)) else { continue };
        let step = a.len() / SOME_ROWS + 1;
        let rows: Vec<usize> = (0..a.len()).step_by(step).filter(|i| a[*i].is_finite() && b[*i].is_finite()).collect();
        let Some(&row) = rows.first() else { continue };
        let apart = |p: f64, q: f64| median(rows.iter().map(|i| (p * a[*i] - q * b[*i]).abs()).collect());
        let (same, first, second) = (apart(1.0, 1.0), apart(FOOT, 1.0), apart(1.0, FOOT));
        // Heights above the ellipsoid, above sea level and by pressure differ by less.
        if same < 200.0 || first.min(second) > 0.2 * same || rise_together(a, b, &rows) {
            continue;
        }
        let (wrong, value) = if first < second { (one, a[row]) } else { (other, b[row]) };
        let what = format!("`{one}` and `{other}` are {} m apart", shown(same.round()));
        let help = format!("they agree if `{wrong}` is in ft: {}", line.origins.units(&[wrong], "ft"));
        return Some(line.contradiction((wrong, row, value, "m"), a.len(), what, &help));
    }
    None
}

/// Whether two heights change by the same amount. They then have the same unit and differ only by a constant, as when a
/// barometer is set to 0 on the ground.
fn rise_together(a: &[f64], b: &[f64], rows: &[usize]) -> bool {
    let column = |x: &[f64]| rows.iter().map(|i| x[*i]).collect::<Vec<f64>>();
    let (a, b) = (column(a), column(b));
    let apart: Vec<f64> = a.iter().zip(&b).map(|(a, b)| a - b).collect();
    let [a, b, apart] = [a, b, apart].map(|x| statistics::std(&x).value);
    // A height in the other unit would change by three times as much, so the difference would be two thirds of the
    // larger change.
    apart < 0.4 * a.min(b)
}

/// Fault of a heading that agrees with the course only if it is in radians.
fn attitude(line: &ConsistencyLine, set: MotionColumns) -> Option<(Fault, Finding)> {
    let (tt, lat, lon, yaw) = (line.get("tt")?, line.get(set.lat)?, line.get(set.lon)?, line.get(set.yaw)?);
    if !could_be_radians(yaw, std::f64::consts::TAU + 1e-6) {
        return None;
    }
    let all = chords([tt, lat, lon], None, motion::CHORD_S);
    let moving = all.iter().filter(|c| length(c.moved) > MOVING_MPS * c.seconds && yaw[c.row].is_finite());
    let pairs: Vec<(f64, f64)> = moving.map(|c| (c.moved[1].atan2(c.moved[0]).to_degrees(), yaw[c.row])).collect();
    let apart = |scale: f64| median(pairs.iter().map(|(course, yaw)| wrap_deg(course - scale * yaw).abs()).collect());
    if pairs.len() < 3 || apart(1.0) < 45.0 || apart(1f64.to_degrees()) > 30.0 {
        return None;
    }
    let row = all.first().map_or(0, |c| c.row);
    let what = format!(
        "the heading differs from the course over ground by {} deg, or by {} deg if it is in rad",
        shown(apart(1.0).round()),
        shown(apart(1f64.to_degrees()).round())
    );
    let angles = if set.yaw == TRUTH.yaw { ["roll", "pitch", "yaw"] } else { ["ins_roll", "ins_pitch", "ins_yaw"] };
    let help = format!("the angles are probably in radians: {}", line.origins.units(&angles, "rad"));
    Some(line.contradiction((set.yaw, row, yaw[row], "deg"), yaw.len(), what, &help))
}

/// Fault of a specific force that differs greatly from gravity.
fn specific_force(line: &ConsistencyLine) -> Option<(Fault, Finding)> {
    let (n, e, d) = (line.get("ins_fn")?, line.get("ins_fe")?, line.get("ins_fd")?);
    let step = n.len() / SOME_ROWS + 1;
    let force = |i: usize| (n[i] * n[i] + e[i] * e[i] + d[i] * d[i]).sqrt();
    let some: Vec<f64> = (0..n.len()).step_by(step).map(force).filter(|f| f.is_finite()).collect();
    let usual = median(some);
    // Zero throughout is a placeholder, which the check for constant sensors reports.
    if usual.is_nan() || usual == 0.0 || (3.0..30.0).contains(&usual) {
        return None;
    }
    let what = format!(
        "the specific force is {} m/s2 on average, but in flight it is 9.8 m/s2, including gravity",
        shown(round(usual))
    );
    let help = if (0.8..1.25).contains(&usual) {
        "the columns are probably in g; convert them to m/s2"
    } else {
        "correct the file"
    };
    let row = (0..n.len()).find(|i| force(*i).is_finite())?;
    Some(line.contradiction(("ins_fd", row, d[row], "m/s2"), n.len(), what, help))
}
