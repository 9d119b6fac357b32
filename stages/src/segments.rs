//! Straight parts, turns and manoeuvres of a line.

use std::{ops::Range, sync::Arc};

use arrow_array::{Int64Array, RecordBatch, StringArray};
use numerics::{
    angle::unwrapped_deg,
    signal::{
        savitzky_golay::SavitzkyGolay,
        segments::{RowMask, filter_column},
    },
};
use schemas::{Column, Fault, LineInput, LineOutput, LineStage, Rule, Stage, StageSchema, Table, stage};

use crate::{
    bandpass::design,
    columns::{band, data, even_rate_hz, floats, not_numbers_among, role_of, shape},
};

stage! {
    /// Divides each line into straight parts, turns and manoeuvres. Appends `segment`, the number of the part from 1,
    /// and `segment_kind`: `straight`, `turn`, `manoeuvre`, or `none` if the heading is missing.
    ///
    /// In a turn the heading changes faster than `turn_dps` and by at least `turn_deg` in total, so the yaw manoeuvres
    /// of a calibration are not turns. A part shorter than `least_s` between two turns is counted as a turn. Manoeuvres
    /// are detected within straight parts. In a manoeuvre, the root mean square of the band-passed columns of
    /// `attitude` (angles, or components of a vector magnetometer) over `window_s` exceeds `manoeuvre`. Examples are
    /// the pitch, roll and yaw manoeuvres of a calibration box. Boundaries are accurate to within one window length.
    ///
    /// `select` with `rows = "segment_kind = 'straight'"` keeps the straight parts as one line. Samples must be evenly
    /// spaced. A gap in time or a missing heading ends a segment. A run shorter than the window has the kind `none`.
    /// The heading may be a course computed with `derive`: `degrees(atan2(ve, vn))`.
    Segments = "segments", version 1, grain Line, inputs [input: Lines],
    example r#"
[[stages]]
name     = "segments"
stage    = "segments"
input    = "derive"
heading  = "heading"
turn_dps = 5.0
attitude = ["heading"]
"#;
    /// Heading or course.
    heading: String, unit "deg", default "yaw";
    /// Window over which the turn rate is computed and manoeuvres are detected.
    window_s: f64, unit "s", default 5.0, rule Rule::Positive;
    /// Minimum turn rate of a turn.
    turn_dps: f64, unit "deg/s", default 1.0, rule Rule::Positive;
    /// Minimum change in heading in a turn.
    turn_deg: f64, unit "deg", default 20.0, rule Rule::NotNegative;
    /// Shortest straight part.
    least_s: f64, unit "s", default 20.0, rule Rule::NotNegative;
    /// Columns that show manoeuvres, all in the same unit.
    attitude: Vec<String>, unit "", default Vec::<String>::new();
    /// Threshold of a manoeuvre: square root of the sum of the columns' mean squares over `window_s`, in the unit of
    /// `attitude`.
    manoeuvre: f64, unit "", default 2.0, rule Rule::Positive;
    /// Lower corner frequency of the band-pass filter for `attitude`.
    low_hz: f64, unit "Hz", default 0.05, rule Rule::NotNegative;
    /// Upper corner frequency of the band-pass filter. With 0 the filter has no upper corner.
    high_hz: f64, unit "Hz", default 0.0, rule Rule::NotNegative;
}

/// Kind of a part of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum LineSegmentKind {
    None,
    Straight,
    Turn,
    Manoeuvre,
}

impl LineSegmentKind {
    const fn word(self) -> &'static str {
        match self {
            LineSegmentKind::None => "none",
            LineSegmentKind::Straight => "straight",
            LineSegmentKind::Turn => "turn",
            LineSegmentKind::Manoeuvre => "manoeuvre",
        }
    }
}

/// Runs of equal entries.
fn runs<T: PartialEq>(entries: &[T]) -> Vec<Range<usize>> {
    let mut found: Vec<Range<usize>> = vec![];
    for (row, entry) in entries.iter().enumerate() {
        match found.last_mut() {
            Some(run) if entries.get(run.start) == Some(entry) => run.end = row + 1,
            _ => found.push(row..row + 1),
        }
    }
    found
}

impl Segments {
    /// Number of samples of a window, odd and at least 3.
    fn window(&self, rate_hz: f64) -> usize {
        2 * ((0.5 * self.window_s * rate_hz).round() as usize).max(1) + 1
    }

    /// Straight parts and turns of a run with the unwrapped heading `heading`. `None` if it is shorter than the window.
    fn turns(&self, heading: &[f64], rate_hz: f64) -> Result<Option<Vec<LineSegmentKind>>, Fault> {
        let slope = SavitzkyGolay::new(self.window(rate_hz), 2, 1);
        let slope = slope.map_err(|e| Fault::data(e.to_string()).help("lower `window_s`"))?;
        let Some(rates) = slope.apply(heading) else { return Ok(None) };
        let side = |rate: &f64| if (rate * rate_hz).abs() < self.turn_dps { 0.0 } else { rate.signum() };
        let mut sides: Vec<f64> = rates.iter().map(side).collect();
        // Intervals of slow rotation within a turn belong to the turn.
        let short = self.window(rate_hz);
        let parts = runs(&sides);
        for w in parts.windows(3) {
            let [before, between, after] = w else { continue };
            let same = sides[before.start] == sides[after.start] && sides[between.start] == 0.0;
            if same && between.len() < short {
                let to = sides[before.start];
                sides[between.clone()].fill(to);
            }
        }
        let mut kinds = vec![LineSegmentKind::Straight; heading.len()];
        for run in runs(&sides).into_iter().filter(|run| sides[run.start] != 0.0) {
            let change = heading[run.end - 1] - heading[run.start];
            if change.abs() >= self.turn_deg {
                kinds[run].fill(LineSegmentKind::Turn);
            }
        }
        let least = (self.least_s * rate_hz).round() as usize;
        let parts = runs(&kinds);
        for (i, part) in parts.iter().enumerate() {
            let between = i > 0 && i + 1 < parts.len();
            if between && kinds[part.start] == LineSegmentKind::Straight && part.len() < least {
                kinds[part.clone()].fill(LineSegmentKind::Turn);
            }
        }
        Ok(Some(kinds))
    }

    /// Samples at which the columns of `attitude` vary by more than `manoeuvre`; none without such columns.
    fn manoeuvres(&self, batch: &RecordBatch, tt: &[f64], rate_hz: f64) -> Result<Vec<bool>, Fault> {
        let mut squares = vec![0.0; tt.len()];
        for name in &self.attitude {
            let x = floats(batch, name)?;
            let filter = design(self.low_hz, self.high_hz, 4, rate_hz)?;
            let runs = RowMask::all(x.len()).and_finite(x).runs_in_time(tt, rate_hz);
            let y = match &filter {
                Some(filter) => filter_column(filter, x, &runs).map_err(|e| data(e).in_column(name))?.0,
                None => x.to_vec(),
            };
            // A missing value does not indicate a manoeuvre.
            squares.iter_mut().zip(&y).filter(|(_, y)| y.is_finite()).for_each(|(sum, y)| *sum += y * y);
        }
        let half = self.window(rate_hz) / 2;
        let mut sums = vec![0.0];
        sums.extend(squares.iter().scan(0.0, |sum, x| {
            *sum += x;
            Some(*sum)
        }));
        let mean = |row: usize| {
            let (from, to) = (row.saturating_sub(half), (row + half + 1).min(squares.len()));
            (sums[to] - sums[from]) / (to - from) as f64
        };
        let mut found: Vec<bool> = (0..squares.len()).map(|row| mean(row) > self.manoeuvre * self.manoeuvre).collect();
        // Intervals between the movements of one manoeuvre belong to the manoeuvre.
        for run in runs(&found) {
            let inside = run.start > 0 && run.end < found.len();
            if inside && !found[run.start] && run.len() < 2 * half + 1 {
                found[run].fill(true);
            }
        }
        Ok(found)
    }

    fn kinds(&self, batch: &RecordBatch) -> Result<Vec<(usize, LineSegmentKind)>, Fault> {
        let tt = floats(batch, "tt")?;
        let rate_hz = even_rate_hz(tt)?;
        let heading = unwrapped_deg(floats(batch, &self.heading)?);
        let busy = self.manoeuvres(batch, tt, rate_hz)?;
        // The end of a run ends a segment, and so does a change of kind.
        let mut found = vec![(0, LineSegmentKind::None); tt.len()];
        for (n, run) in RowMask::all(tt.len()).and_finite(&heading).runs_in_time(tt, rate_hz).into_iter().enumerate() {
            let Some(kinds) = self.turns(&heading[run.clone()], rate_hz)? else { continue };
            for (row, kind) in run.zip(kinds) {
                let busy = kind == LineSegmentKind::Straight && busy[row];
                found[row] = (n + 1, if busy { LineSegmentKind::Manoeuvre } else { kind });
            }
        }
        Ok(found)
    }
}

impl Stage for Segments {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let mut faults = vec![];
        if let Err(fault) = shape.number(&self.heading, "deg") {
            faults.push(
                fault
                    .help("set `heading` to the column of the heading, or compute a course with `derive`")
                    .of_param("heading"),
            );
        }
        if !self.attitude.is_empty() {
            faults.extend(not_numbers_among(shape, &self.attitude, "attitude"));
            faults.extend(band(self.low_hz, self.high_hz, shape.rate_hz));
            let mut units = self.attitude.iter().filter_map(|name| Some(shape.get(name)?.unit.as_str()));
            let first = units.next();
            if let Some(other) = units.find(|unit| Some(*unit) != first) {
                let what = format!(
                    "`attitude` mixes columns in {} and in {other}; all must have one unit",
                    first.unwrap_or_default()
                );
                faults.push(Fault::new(what).of_param("attitude"));
            }
        }
        if !faults.is_empty() {
            return Err(faults);
        }
        let reads: Vec<&str> =
            ["tt", &self.heading].into_iter().chain(self.attitude.iter().map(String::as_str)).collect();
        let role = role_of(shape, &reads);
        let columns = vec![
            Column::integer("segment", "", "number of the part of the line, from 1").role(role),
            Column::text("segment_kind", "straight, turn, manoeuvre or none").role(role),
        ];
        Ok(StageSchema::append(columns.into_iter().map(|c| c.from(0, &reads)).collect(), &reads))
    }
}

impl LineStage for Segments {
    type Prepared = ();

    fn run(&self, line: &LineInput, (): &()) -> LineOutput {
        let batch = line.inputs.first().ok_or_else(|| Fault::bug("a stage has no input"))?;
        let kinds = self.kinds(batch)?;
        let mut numbers = vec![0; kinds.len()];
        for (n, run) in runs(&kinds).into_iter().enumerate() {
            numbers[run].fill(n as i64 + 1);
        }
        let words: StringArray = kinds.iter().map(|(_, kind)| Some(kind.word())).collect();
        Ok(vec![Arc::new(Int64Array::from(numbers)), Arc::new(words)])
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::f64::consts::TAU;

    use arrow_array::{cast::AsArray, types::Int64Type};

    use super::*;
    use crate::testing::{batch, fault_texts, line, sampled, table};

    const RATE_HZ: f64 = 10.0;

    fn segments() -> Segments {
        Segments {
            heading: "yaw".into(),
            window_s: 5.0,
            turn_dps: 1.0,
            turn_deg: 20.0,
            least_s: 20.0,
            attitude: vec!["roll".into(), "pitch".into()],
            manoeuvre: 2.0,
            low_hz: 0.05,
            high_hz: 0.0,
        }
    }

    /// A box with legs of 80 s and right turns of 30 s at 3 degrees per second. In the middle of each leg, from 30 to
    /// 50 s, there are rolls of 5 degrees.
    fn heading(t: f64) -> f64 {
        let (leg, s) = ((t / 110.0).floor(), t.rem_euclid(110.0));
        // Yaw of 3 degrees amplitude on the legs, at up to 3 degrees per second.
        let yaw = if (30.0..50.0).contains(&s) { 3.0 * (TAU * 0.15 * s).sin() } else { 0.0 };
        (300.0 + 90.0 * leg + 3.0 * (s - 80.0).max(0.0) + yaw).rem_euclid(360.0)
    }

    fn roll(t: f64) -> f64 {
        let s = t.rem_euclid(110.0);
        if (30.0..50.0).contains(&s) { 5.0 * (TAU * 0.2 * s).sin() } else { 0.0 }
    }

    /// The parts: kind, first and last time.
    fn parts(stage: &Segments, rows: usize, change: impl Fn(&mut Vec<f64>)) -> Vec<(String, f64, f64)> {
        let tt = sampled(0.0, RATE_HZ, rows, |t| t);
        let mut yaw = sampled(0.0, RATE_HZ, rows, heading);
        change(&mut yaw);
        let columns = vec![
            ("tt", "s", tt.clone()),
            ("yaw", "deg", yaw),
            ("roll", "deg", sampled(0.0, RATE_HZ, rows, roll)),
            ("pitch", "deg", vec![2.0; rows]),
        ];
        let made = stage.run(&line(vec![batch(columns)]), &()).unwrap();
        let numbers = made[0].as_primitive::<Int64Type>().values().to_vec();
        let words = made[1].as_string::<i32>();
        let found = runs(&numbers);
        assert!(found.iter().enumerate().all(|(n, run)| numbers[run.start] == n as i64 + 1));
        found.into_iter().map(|r| (words.value(r.start).to_owned(), tt[r.start], tt[r.end - 1])).collect()
    }

    #[test]
    fn unit_legs_turns_and_manoeuvres_of_a_box_are_found() {
        let found = parts(&segments(), 4100, |_| {});
        let kinds: Vec<&str> = found.iter().map(|(kind, ..)| kind.as_str()).collect();
        let leg = ["straight", "manoeuvre", "straight", "turn"];
        assert_eq!(kinds, leg.repeat(4)[..15], "{found:?}");
        for (i, (kind, first, last)) in found.iter().enumerate().take(14) {
            let begun = 110.0 * (i / 4) as f64;
            let (from, to) = match i % 4 {
                0 => (0.0, 30.0),
                1 => (30.0, 50.0),
                2 => (50.0, 80.0),
                _ => (80.0, 110.0),
            };
            // The boundaries are accurate to the length of the window.
            assert!((first - begun - from).abs() < 5.0 && (last - begun - to).abs() < 5.0, "{kind}: {first} to {last}");
        }
        let plain = Segments { attitude: vec![], ..segments() };
        assert_eq!(parts(&plain, 4100, |_| {}).len(), 7, "legs and turns alone");
    }

    #[test]
    fn unit_small_yaws_are_no_turns_and_missing_samples_are_none() {
        let plain = Segments { attitude: vec![], ..segments() };
        let sharp = parts(&Segments { turn_deg: 0.0, least_s: 0.0, ..plain.clone() }, 800, |_| {});
        assert!(sharp.iter().any(|(kind, ..)| kind == "turn"), "{sharp:?}");
        let found = parts(&plain, 800, |yaw| yaw[400..410].fill(f64::NAN));
        let kinds: Vec<&str> = found.iter().map(|(kind, ..)| kind.as_str()).collect();
        assert_eq!(kinds, ["straight", "none", "straight"]);
        assert_eq!(parts(&plain, 20, |_| {})[0].0, "none", "shorter than the window");
    }

    #[test]
    fn unit_columns_and_units_are_checked_before_the_run() {
        let lines = table(&[("tt", "s"), ("ins_yaw", "deg"), ("ins_roll", "deg"), ("flux_a_x", "nT")], Some(RATE_HZ));
        let of = |stage: Segments| fault_texts(stage.yields(&[&lines]).unwrap_err());
        let fine = Segments { heading: "ins_yaw".into(), attitude: vec!["ins_roll".into()], ..segments() };
        assert_eq!(fine.yields(&[&lines]).unwrap().columns.len(), 2);
        assert!(of(Segments { heading: "yaw".into(), ..fine.clone() }).ends_with("[heading]"));
        assert!(of(Segments { heading: "flux_a_x".into(), ..fine.clone() }).contains("deg is needed"));
        let mixed = vec!["ins_roll".to_owned(), "flux_a_x".to_owned()];
        assert!(of(Segments { attitude: mixed, ..fine.clone() }).ends_with("[attitude]"));
        assert!(of(Segments { high_hz: 6.0, ..fine }).ends_with("[high_hz]"));
    }
}
