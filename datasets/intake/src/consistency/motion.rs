//! Velocities against the motion of the positions and heights.

use numerics::earth::geodesy::EarthModel;
use schemas::{Fault, convert, plausible::shown};

use super::{ConsistencyLine, Finding, INS, MOVING_MPS, MotionColumns, TRUTH, both_could_be_radians, round};

/// The duration of the chords over which positions and velocities are compared.
pub const CHORD_S: f64 = 10.0;
/// Minimum number of chords. If a line has fewer chords of [`CHORD_S`], it is divided into shorter chords of at least
/// [`SHORT_CHORD_S`].
const CHORDS: usize = 3;
const SHORT_CHORD_S: f64 = 1.0;
/// Below this mean speed the noise of positions hides the velocity over short chords.
const SHORT_MOVING_MPS: f64 = 15.0;
/// A longer pause between samples ends a chord.
const PAUSE_S: f64 = 5.0;
/// Fractions of the distance flown. If positions and velocities disagree by the first fraction or more, but agree
/// within the second fraction in another unit, the line has a fault.
const DISAGREE: f64 = 0.4;
const AGREE: f64 = 0.15;
/// Ratio of the two mean speeds above which a disagreement is a fault even if no other unit explains it.
const RATIO: f64 = 5.0;
/// A chord with a smaller change of height gives no information on the vertical velocity.
const CLIMB_M: f64 = 15.0;

/// Usual names of the speed over ground. Wind and airspeed are not included.
const GROUND_SPEEDS: [&str; 5] = ["speed_over_ground", "ground_speed", "groundspeed", "gnd_speed", "sog"];

/// Units of a velocity over ground, and of a vertical velocity.
const SPEEDS: [&str; 6] = ["m/s", "km/h", "kn", "ft/s", "mph", "cm/s"];
const CLIMBS: [&str; 7] = ["m/s", "ft/s", "ft/min", "m/min", "km/h", "kn", "cm/s"];

/// The displacement over a chord, north and east in metres, by positions and by velocities; the row at which the chord
/// begins.
pub struct MotionChord {
    pub row: usize,
    pub seconds: f64,
    pub moved: [f64; 2],
    pub integrated: [f64; 2],
}

/// Chords of at least `chord_s`, from times, latitudes and longitudes. Without velocities, `integrated` is zero.
pub fn chords([tt, lat, lon]: [&[f64]; 3], velocity: Option<(&[f64], &[f64])>, chord_s: f64) -> Vec<MotionChord> {
    let mut found = vec![];
    let (mut start, mut integrated) = (0, [0.0; 2]);
    for i in 1..tt.len() {
        let dt = tt[i] - tt[i - 1];
        if let Some((vn, ve)) = velocity {
            integrated[0] += 0.5 * (vn[i] + vn[i - 1]) * dt;
            integrated[1] += 0.5 * (ve[i] + ve[i - 1]) * dt;
        }
        let whole =
            lat[start].is_finite() && lon[start].is_finite() && integrated[0].is_finite() && integrated[1].is_finite();
        if !(whole && dt > 0.0 && dt <= PAUSE_S) {
            (start, integrated) = (i, [0.0; 2]);
        } else if tt[i] - tt[start] >= chord_s {
            let (north, east) = EarthModel::Wgs84.offset_ne_m((lat[start], lon[start]), (lat[i], lon[i]), 0.0);
            if north.is_finite() && east.is_finite() {
                found.push(MotionChord { row: start, seconds: tt[i] - tt[start], moved: [north, east], integrated });
            }
            (start, integrated) = (i, [0.0; 2]);
        }
    }
    found
}

pub fn length(v: [f64; 2]) -> f64 {
    v[0].hypot(v[1])
}

/// The mean speed over chords, in m/s, from one of the two displacements.
pub fn mean_speed(chords: &[MotionChord], displacement: fn(&MotionChord) -> [f64; 2]) -> f64 {
    let seconds: f64 = chords.iter().map(|c| c.seconds).sum();
    chords.iter().map(|c| length(displacement(c))).sum::<f64>() / seconds
}

/// Disagreement of positions and velocities as a share of the distance. The function `turn` converts the velocities
/// first.
fn disagreement(chords: &[MotionChord], turn: impl Fn([f64; 2]) -> [f64; 2]) -> f64 {
    let (mut apart, mut moved, mut integrated) = (0.0, 0.0, 0.0);
    for chord in chords {
        let f = turn(chord.integrated);
        apart += length([chord.moved[0] - f[0], chord.moved[1] - f[1]]);
        moved += length(chord.moved);
        integrated += length(f);
    }
    apart / f64::max(moved, integrated)
}

/// Fault of positions that do not move with the velocities. Compares the truth, then the INS. If only one of the two
/// has positions, compares these positions with the velocities of the other.
pub fn horizontal(line: &ConsistencyLine) -> Option<(Fault, Finding)> {
    let own = [TRUTH, INS].into_iter().find_map(|set| motion(line, set));
    let mixed = || match (line.get(TRUTH.lat), line.get(INS.lat)) {
        (Some(_), None) => motion(line, MotionColumns { vn: INS.vn, ve: INS.ve, ..TRUTH }),
        (None, Some(_)) => motion(line, MotionColumns { vn: TRUTH.vn, ve: TRUTH.ve, ..INS }),
        _ => None,
    };
    own.or_else(mixed)
}

/// Other possible units of velocities, with their factors to the given unit.
fn other_units<'a>(line: &ConsistencyLine, column: &str, units: &'a [&'a str]) -> Vec<(&'a str, f64)> {
    let declared = match line.origins.unit(column) {
        "" => "m/s",
        unit => unit,
    };
    let factor = |unit: &&'a str| Some((*unit, convert(unit, declared)?));
    units.iter().filter_map(factor).filter(|(_, factor)| (factor - 1.0).abs() > 0.01).collect()
}

/// Fault of positions that do not move with the velocities.
fn motion(line: &ConsistencyLine, set: MotionColumns) -> Option<(Fault, Finding)> {
    let (tt, lat, lon) = (line.get("tt")?, line.get(set.lat)?, line.get(set.lon)?);
    let (vn, ve) = (line.get(set.vn)?, line.get(set.ve)?);
    let over = |chord_s: f64| chords([tt, lat, lon], Some((vn, ve)), chord_s);
    let mut all = over(CHORD_S);
    let short = all.len() < CHORDS;
    if short {
        let span_s = tt.last()? - tt.first()?;
        all = over((span_s / (CHORDS + 2) as f64).clamp(SHORT_CHORD_S, CHORD_S));
    }
    let (moved, integrated) = (mean_speed(&all, |c| c.moved), mean_speed(&all, |c| c.integrated));
    let slow = if short { moved.min(integrated) < SHORT_MOVING_MPS } else { moved.max(integrated) < MOVING_MPS };
    // Velocities that are zero throughout are placeholders, which the check for constant sensors reports.
    if all.len() < CHORDS || slow || integrated == 0.0 || disagreement(&all, |f| f) < DISAGREE {
        return None;
    }
    let mut causes = in_other_units(line, set, &all);
    if !short {
        causes.extend(otherwise(line, set, &all));
    }
    if !short && both_could_be_radians(lat, lon) {
        let turned = |x: &[f64]| x.iter().map(|x| x.to_degrees()).collect::<Vec<f64>>();
        let turned = chords([tt, &turned(lat), &turned(lon)], Some((vn, ve)), CHORD_S);
        causes.push((disagreement(&turned, |f| f), line.in_radians(set)));
    }
    let best = causes.into_iter().filter(|c| c.0 < AGREE).min_by(|a, b| a.0.total_cmp(&b.0));
    let help = match best {
        Some((_, help)) => help,
        None if !short && moved.max(integrated) > RATIO * moved.min(integrated) => "correct the file".to_owned(),
        None => return None,
    };
    let what = format!(
        "the positions move at {} m/s on average, but `{}` and `{}` are {} m/s",
        shown(round(moved)),
        set.vn,
        set.ve,
        shown(round(integrated))
    );
    let row = all.first().map_or(0, |c| c.row);
    Some(line.contradiction((set.lat, row, lat[row], "deg"), all.len(), what, &help))
}

/// Remaining disagreement if one or both velocities were in another unit, and the remedy.
fn in_other_units(line: &ConsistencyLine, set: MotionColumns, all: &[MotionChord]) -> Vec<(f64, String)> {
    let mut causes = vec![];
    for columns in [vec![set.vn, set.ve], vec![set.vn], vec![set.ve]] {
        let (north, east) = (columns.contains(&set.vn), columns.contains(&set.ve));
        for (unit, by) in columns.first().map(|c| other_units(line, c, &SPEEDS)).unwrap_or_default() {
            let scaled = |f: [f64; 2]| [if north { by * f[0] } else { f[0] }, if east { by * f[1] } else { f[1] }];
            let fit =
                if north && east { "the velocities agree".to_owned() } else { format!("`{}` agrees", columns[0]) };
            causes
                .push((disagreement(all, scaled), format!("in {unit}, {fit}: {}", line.origins.units(&columns, unit))));
        }
    }
    causes
}

/// Remaining disagreement if the axes were swapped or reversed, and the remedy.
fn otherwise(line: &ConsistencyLine, set: MotionColumns, all: &[MotionChord]) -> [(f64, String); 2] {
    let (n, e) = (line.origins.name(set.vn), line.origins.name(set.ve));
    let signs = format!("`{e}` and the change in longitude have opposite signs; both must be positive to the east");
    [
        (disagreement(all, |f| [f[1], f[0]]), format!("`{n}` and `{e}` are probably swapped; use `rename`")),
        (disagreement(all, |f| [f[0], -f[1]]), signs),
    ]
}

/// Fault of a speed over ground that agrees with the positions only in a unit that differs from the given one.
pub fn ground_speed(line: &ConsistencyLine) -> Option<(Fault, Finding)> {
    let (tt, lat, lon) = (line.get("tt")?, line.get(TRUTH.lat)?, line.get(TRUTH.lon)?);
    GROUND_SPEEDS.into_iter().find_map(|name| {
        let speed = line.get(name)?;
        let declared = Some(line.origins.unit(name)).filter(|unit| !unit.is_empty())?;
        let to_mps = convert(declared, "m/s")?;
        let all = chords([tt, lat, lon], Some((speed, &vec![0.0; speed.len()])), CHORD_S);
        let fit = |by: f64| {
            let (moved, integrated) =
                all.iter().fold((0.0, 0.0), |(m, f), c| (m + length(c.moved), f + by * c.integrated[0]));
            (moved - integrated).abs() / f64::max(moved, integrated)
        };
        let moved = mean_speed(&all, |c| c.moved);
        if all.len() < CHORDS || moved < SHORT_MOVING_MPS || fit(to_mps) < DISAGREE {
            return None;
        }
        let causes = SPEEDS.into_iter().filter_map(|unit| Some((fit(convert(unit, "m/s")?), unit)));
        let (_, unit) = causes.filter(|c| c.0 < AGREE).min_by(|a, b| a.0.total_cmp(&b.0))?;
        let what =
            format!("the positions move at {} m/s, and `{name}` agrees only if it is in {unit}", shown(round(moved)));
        let row = all.first().map_or(0, |c| c.row);
        let at = (name, row, speed.get(row).copied().unwrap_or(f64::NAN), declared);
        Some(line.contradiction(at, all.len(), what, &line.origins.units(&[name], unit)))
    })
}

/// Fault of heights that change with the vertical velocity only in another unit.
pub fn vertical(line: &ConsistencyLine, set: MotionColumns) -> Option<(Fault, Finding)> {
    let (tt, alt, vd) = (line.get("tt")?, line.get(set.alt)?, line.get(set.vd)?);
    let climbs = climbs(tt, alt, vd);
    if climbs.len() < CHORDS || disagreement(&climbs, |f| f) < DISAGREE {
        return None;
    }
    let units = other_units(line, set.vd, &CLIMBS).into_iter();
    let causes = units.map(|(unit, by)| (disagreement(&climbs, |f| [by * f[0], 0.0]), unit));
    let (_, unit) = causes.filter(|c| c.0 < AGREE).min_by(|a, b| a.0.total_cmp(&b.0))?;
    let what = format!(
        "`{}` changes at {} m/s on average, but `{}` is {} m/s on average",
        set.alt,
        shown(round(mean_speed(&climbs, |c| c.moved))),
        set.vd,
        shown(round(mean_speed(&climbs, |c| c.integrated)))
    );
    let help = format!("in {unit}, `{}` agrees with the heights: {}", set.vd, line.origins.units(&[set.vd], unit));
    let row = climbs.first().map_or(0, |c| c.row);
    Some(line.contradiction((set.vd, row, vd[row], "m/s"), climbs.len(), what, &help))
}

/// Chords that climb or sink by [`CLIMB_M`] or more; their first components hold the change of height, from the heights
/// and from the vertical velocity.
fn climbs(tt: &[f64], alt: &[f64], vd: &[f64]) -> Vec<MotionChord> {
    let mut found = vec![];
    let (mut start, mut integrated) = (0, 0.0);
    for i in 1..tt.len() {
        let dt = tt[i] - tt[i - 1];
        integrated -= 0.5 * (vd[i] + vd[i - 1]) * dt;
        let seconds = tt[i] - tt[start];
        let whole = alt[start].is_finite() && integrated.is_finite() && dt > 0.0 && dt <= PAUSE_S;
        if whole && seconds >= CHORD_S {
            let moved = alt[i] - alt[start];
            if moved.abs() >= CLIMB_M {
                found.push(MotionChord { row: start, seconds, moved: [moved, 0.0], integrated: [integrated, 0.0] });
            }
        }
        if !whole || seconds >= CHORD_S {
            (start, integrated) = (i, 0.0);
        }
    }
    found
}
