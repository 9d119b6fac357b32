//! Figures of the quality of a line's data: sampling, dropouts, spikes, noise, quantisation, saturation and stuck
//! channels of each column, and dead zones and lags of magnetometers. Each check is one file with one function, which
//! processes plain numbers.

mod dead_zone;
mod dropouts;
mod lag;
mod look;
mod magnetometers;
mod noise;
mod preferred;
mod quantisation;
mod sampling;
mod saturation;
mod spikes;
mod stretches;
pub(crate) mod stuck;
pub mod table;

pub use look::{FigureContext, needs_a_look};
pub use stretches::{gaps, stretches};

use arrow_array::{RecordBatch, cast::AsArray, types::Float64Type};
use arrow_schema::DataType;
use schemas::{Role, describe_field, flight};

use super::finding::{Finding, FindingKind};

/// Version of the checks, increased when the figures of the checks change.
pub const VERSION: &str = "checks 3";

/// Kind of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum QualityFigure {
    /// Reciprocal of the median time step.
    Rate,
    /// The robust standard deviation of the steps.
    Jitter,
    /// Total time missing in gaps.
    Gaps,
    /// Longest gap.
    LongestGap,
    /// Rows that repeat the time of the previous row.
    RepeatedTime,
    /// Rows with an earlier time.
    BackwardTime,
    /// Midnights within the line.
    Midnight,
    /// Missing values: the longest time without a value.
    Dropouts,
    /// The longest time with a constant value.
    Stuck,
    /// The saturated value, at an end of the range.
    Saturation,
    /// Quantisation step of the values.
    Quantisation,
    /// The standard deviation of white noise.
    Noise,
    /// The height of the largest spike.
    Spikes,
    /// Spacing of the over-represented values of a scalar magnetometer.
    Preferred,
    /// Longest time for which a scalar magnetometer reports that the field is in its dead zone.
    DeadZone,
    /// Half width of the cone of field directions without readings.
    PolarDeadZone,
    /// Half width of the belt of field directions without readings.
    EquatorialDeadZone,
    /// Lag against the first magnetometer of the same kind.
    Lag,
    /// A finding of the examination.
    Found(FindingKind),
}

impl QualityFigure {
    /// All kinds.
    pub const ALL: [QualityFigure; 25] = [
        QualityFigure::Rate,
        QualityFigure::Jitter,
        QualityFigure::Gaps,
        QualityFigure::LongestGap,
        QualityFigure::RepeatedTime,
        QualityFigure::BackwardTime,
        QualityFigure::Midnight,
        QualityFigure::Dropouts,
        QualityFigure::Stuck,
        QualityFigure::Saturation,
        QualityFigure::Quantisation,
        QualityFigure::Noise,
        QualityFigure::Spikes,
        QualityFigure::Preferred,
        QualityFigure::DeadZone,
        QualityFigure::PolarDeadZone,
        QualityFigure::EquatorialDeadZone,
        QualityFigure::Lag,
        QualityFigure::Found(FindingKind::Missing),
        QualityFigure::Found(FindingKind::Infinite),
        QualityFigure::Found(FindingKind::ZeroReading),
        QualityFigure::Found(FindingKind::Impossible),
        QualityFigure::Found(FindingKind::NotTotalField),
        QualityFigure::Found(FindingKind::Inconsistent),
        QualityFigure::Found(FindingKind::Constant),
    ];

    /// The kind as text.
    pub const fn as_str(self) -> &'static str {
        match self {
            QualityFigure::Rate => "rate",
            QualityFigure::Jitter => "jitter",
            QualityFigure::Gaps => "gaps",
            QualityFigure::LongestGap => "longest_gap",
            QualityFigure::RepeatedTime => "repeated_time",
            QualityFigure::BackwardTime => "backward_time",
            QualityFigure::Midnight => "midnight",
            QualityFigure::Dropouts => "dropouts",
            QualityFigure::Stuck => "stuck",
            QualityFigure::Saturation => "saturation",
            QualityFigure::Quantisation => "quantisation",
            QualityFigure::Noise => "noise",
            QualityFigure::Spikes => "spikes",
            QualityFigure::Preferred => "preferred_values",
            QualityFigure::DeadZone => "dead_zone",
            QualityFigure::PolarDeadZone => "polar_dead_zone",
            QualityFigure::EquatorialDeadZone => "equatorial_dead_zone",
            QualityFigure::Lag => "lag",
            QualityFigure::Found(check) => check.as_str(),
        }
    }

    /// The figure with the name `word`.
    pub fn from_word(word: &str) -> Option<QualityFigure> {
        QualityFigure::ALL.into_iter().find(|figure| figure.as_str() == word)
    }
}

/// One figure of one column of a line.
#[derive(Clone, Debug, PartialEq)]
pub struct QualityMeasure {
    /// The column.
    pub column: String,
    /// Kind of the check.
    pub check: QualityFigure,
    /// The figure.
    pub value: f64,
    /// Unit.
    pub unit: String,
    /// Number of affected samples.
    pub count: u64,
    /// Time of the first affected sample, in seconds; NaN if the check gives one value for the whole line.
    pub first_tt: f64,
}

/// The figures of all numeric columns of a line, `tt` first. Checks that find nothing give no figure.
pub fn measures(line: &RecordBatch) -> Vec<QualityMeasure> {
    let Some(tt) = line.column_by_name("tt").and_then(|c| c.as_primitive_opt::<Float64Type>()) else { return vec![] };
    let tt: &[f64] = tt.values();
    let mut out = of_time(tt);
    let gaps = sampling::breaks(tt);
    for (field, array) in line.schema().fields().iter().zip(line.columns()) {
        let about = describe_field(field);
        if field.data_type() != &DataType::Float64 || field.name() == "tt" {
            continue;
        }
        let values: Vec<f64> = array.as_primitive::<Float64Type>().iter().map(|x| x.unwrap_or(f64::NAN)).collect();
        of_column(&about, &values, tt, &gaps, &mut out);
    }
    magnetometers::of_magnetometers(line, tt, &mut out);
    out
}

fn of_time(tt: &[f64]) -> Vec<QualityMeasure> {
    let Some(found) = sampling::sampling(tt) else { return vec![] };
    let at = |row: Option<usize>| row.and_then(|r| tt.get(r)).copied().unwrap_or(f64::NAN);
    let all = tt.len() as u64;
    let one = |check, value, unit: &str, count, first| QualityMeasure {
        column: "tt".to_owned(),
        check,
        value,
        unit: unit.to_owned(),
        count,
        first_tt: at(first),
    };
    let mut out = vec![
        one(QualityFigure::Rate, found.rate_hz, "Hz", all, None),
        one(QualityFigure::Jitter, found.jitter_s, "s", all, None),
    ];
    for (check, tally, value, unit) in [
        (QualityFigure::Gaps, found.gaps, found.missing_s, "s"),
        (QualityFigure::LongestGap, found.gaps, found.longest_gap_s, "s"),
        (QualityFigure::RepeatedTime, found.repeated, 0.0, "s"),
        (QualityFigure::BackwardTime, found.backward, found.worst_step_back_s, "s"),
        (QualityFigure::Midnight, found.midnights, 86_400.0, "s"),
    ] {
        if tally.n > 0 {
            out.push(one(check, value, unit, tally.n, tally.first));
        }
    }
    out
}

fn of_column(about: &schemas::Column, values: &[f64], tt: &[f64], gaps: &[bool], out: &mut Vec<QualityMeasure>) {
    let at = |row: usize| tt.get(row).copied().unwrap_or(f64::NAN);
    let mut push = |check, value: f64, unit: &str, count: usize, first: Option<usize>| {
        let first_tt = first.map_or(f64::NAN, at);
        out.push(QualityMeasure {
            column: about.name.clone(),
            check,
            value,
            unit: unit.to_owned(),
            count: count as u64,
            first_tt,
        });
    };
    if let Some(found) = dropouts::dropouts(values, tt) {
        push(QualityFigure::Dropouts, found.longest_s, "s", found.samples, Some(found.first));
    }
    let known: Vec<f64> = values.iter().copied().filter(|x| x.is_finite()).collect();
    let constant = known.windows(2).all(|w| w[0] == w[1]);
    if constant {
        return;
    }
    let is_sensor = about.role == Role::Sensor;
    if is_sensor && let Some(found) = stuck::stuck(values, tt) {
        push(QualityFigure::Stuck, found.longest_s, "s", found.samples, Some(found.first));
    }
    if is_sensor && let Some(found) = saturation::saturation(values) {
        push(QualityFigure::Saturation, found.value, &about.unit, found.samples, Some(found.first));
    }
    let step = quantisation::step(&known);
    if let Some(step) = step {
        push(QualityFigure::Quantisation, step, &about.unit, known.len(), None);
    } else if flight::is_scalar_reading(&about.name)
        && let Some(found) = preferred::preferred(&known)
    {
        push(QualityFigure::Preferred, found.step, &about.unit, found.samples, None);
    }
    let continuous = if wraps(about) { unwrapped(values) } else { values.to_vec() };
    let fourth = noise::fourth_differences(&continuous, gaps);
    let resolution = quantisation::ValueResolution::new(&continuous, step);
    // A column that is constant for more than half of the time has differences of 0, and its steps are not spikes.
    let Some(sigma) = noise::noise(&fourth, &resolution) else { return };
    push(QualityFigure::Noise, sigma, &about.unit, fourth.iter().filter(|d| d.is_finite()).count(), None);
    if let Some(found) = spikes::spikes(&fourth, &resolution) {
        push(QualityFigure::Spikes, found.largest, &about.unit, found.samples, Some(found.first));
    }
}

/// Figures of the findings in a line.
pub fn of_findings(findings: &[Finding], tt: &[f64]) -> Vec<QualityMeasure> {
    let at = |row: u64| usize::try_from(row).ok().and_then(|row| tt.get(row)).copied().unwrap_or(f64::NAN);
    let one = |f: &Finding| QualityMeasure {
        column: f.column.clone(),
        check: QualityFigure::Found(f.check),
        value: f.value().unwrap_or(f64::NAN),
        unit: f.unit.clone(),
        count: f.n,
        first_tt: at(f.first_row),
    };
    // The check `stuck` measures the duration, in every column.
    findings.iter().filter(|f| f.check != FindingKind::Stuck).map(one).collect()
}

/// Whether a column is an angle that jumps by a whole turn.
fn wraps(about: &schemas::Column) -> bool {
    about.unit == "deg" && ["yaw", "roll", "lon", "heading"].iter().any(|end| about.name.ends_with(end))
}

/// Angles in degrees without the jumps.
fn unwrapped(angles: &[f64]) -> Vec<f64> {
    let (mut last, mut turns) = (f64::NAN, 0.0);
    let one = |&x: &f64| {
        if x.is_finite() && last.is_finite() {
            turns -= 360.0 * ((x - last) / 360.0).round();
        }
        if x.is_finite() {
            last = x;
        }
        x + turns
    };
    angles.iter().map(one).collect()
}

/// Number of samples, and the row of the first of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct SampleTally {
    n: u64,
    first: Option<usize>,
}

impl SampleTally {
    fn add(&mut self, row: usize) {
        self.n += 1;
        self.first.get_or_insert(row);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::sync::Arc;

    use arrow_array::{ArrayRef, Float64Array};
    use arrow_schema::{Field, Schema};

    use super::*;

    #[test]
    fn unit_a_line_gives_the_figures_of_each_column() {
        let tt: Vec<f64> = (0..200).map(|i| f64::from(i) * 0.1 + if i >= 100 { 5.0 } else { 0.0 }).collect();
        let mag: Vec<f64> =
            (0..200).map(|i| 50_000.0 + f64::from((i * 7919) % 13) + if i == 150 { 900.0 } else { 0.0 }).collect();
        let yaw: Vec<f64> = (0..200).map(|i| (350.0 + f64::from(i) * 0.37).rem_euclid(360.0)).collect();
        let fields = ["tt", "mag_1_uc", "yaw"].map(|n| {
            let known = schemas::flight::describe(n);
            schemas::field(n, DataType::Float64, known.unit, known.role, "")
        });
        let columns: Vec<ArrayRef> =
            [tt, mag, yaw].into_iter().map(|c| Arc::new(Float64Array::from(c)) as ArrayRef).collect();
        let schema: Schema = Schema::new(fields.to_vec() as Vec<Field>);
        let found = measures(&RecordBatch::try_new(Arc::new(schema), columns).unwrap());
        let of = |column: &str, check: &str| found.iter().find(|m| m.column == column && m.check.as_str() == check);
        assert!((of("tt", "rate").unwrap().value - 10.0).abs() < 1e-9);
        let gap = of("tt", "gaps").unwrap();
        assert!((gap.value - 5.0).abs() < 1e-9 && gap.count == 1 && (gap.first_tt - 15.0).abs() < 1e-9, "{gap:?}");
        assert_eq!(of("mag_1_uc", "quantisation").unwrap().value, 1.0);
        let spikes = of("mag_1_uc", "spikes").unwrap();
        assert_eq!((spikes.count, spikes.first_tt), (1, 20.0), "{spikes:?}");
        // The wrap of yaw from 360 to 0 degrees is not a spike.
        assert_eq!(of("yaw", "spikes"), None);
        assert_eq!(of("yaw", "noise"), None, "there is nothing but rounding");
    }

    #[test]
    fn unit_magnetometers_are_compared_with_each_other() {
        let rows = 3000;
        let at = |t: f64| 50_000.0 + 40.0 * (0.9 * t).sin() + 30.0 * (2.3 * t + 1.0).sin() + 25.0 * (4.1 * t).cos();
        let of = |f: &dyn Fn(f64) -> f64| -> Vec<f64> { (0..rows).map(|k| f(f64::from(k) * 0.1)).collect() };
        // Magnetometer 2 lags, and has no readings where the field is along the body's x axis. The logger reports part
        // of these losses.
        let x = of(&|t| 50_000.0 * (0.4 * t).cos());
        let y = of(&|t| 50_000.0 * (0.4 * t).sin());
        let lost = |k: usize| x[k].abs() > 45_000.0;
        let late: Vec<f64> = (0..3000).map(|k| if lost(k) { f64::NAN } else { at(k as f64 * 0.1 - 0.12) }).collect();
        let flag: Vec<f64> = (0..3000).map(|k| f64::from(u8::from(lost(k) && k < 1000))).collect();
        let columns = [
            ("tt", of(&|t| t)),
            ("mag_1_uc", of(&at)),
            ("mag_2_uc", late),
            ("mag_2_deadzone", flag),
            ("flux_a_x", x),
            ("flux_a_y", y),
            ("flux_a_z", of(&|t| 9000.0 + 10.0 * (0.7 * t).sin())),
            ("flux_b_x", of(&|t| -50_000.0 * (0.4 * (t - 0.05)).cos())),
            ("flux_b_y", of(&|t| -50_000.0 * (0.4 * (t - 0.05)).sin())),
            ("flux_b_z", of(&|_| 9000.0)),
        ];
        let fields: Vec<Field> = columns
            .iter()
            .map(|(n, _)| {
                let known = schemas::flight::describe(n);
                schemas::field(n, DataType::Float64, known.unit, known.role, "")
            })
            .collect();
        let arrays = columns.into_iter().map(|(_, c)| Arc::new(Float64Array::from(c)) as ArrayRef).collect();
        let found = measures(&RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays).unwrap());
        let of = |column: &str, check: &str| found.iter().find(|m| m.column == column && m.check.as_str() == check);
        let lag = of("mag_2_uc", "lag").unwrap();
        assert!((lag.value - 0.12).abs() < 0.005, "{lag:?}");
        let vector = found.iter().find(|m| m.column.starts_with("flux_b") && m.check == QualityFigure::Lag).unwrap();
        assert!((vector.value - 0.05).abs() < 0.005, "{vector:?}");
        let zone = of("mag_2_uc", "polar_dead_zone").unwrap();
        // The field's z component keeps its direction at an angle to the axis: acos(45,000 / |field|).
        let edge = (45_000.0 / 50_000.0_f64.hypot(9000.0)).acos().to_degrees();
        assert!((zone.value - edge).abs() < 2.5, "{zone:?} {edge}");
        let flagged = of("mag_2_uc", "dead_zone").unwrap();
        assert_eq!(flagged.count, (0..1000).filter(|k| lost_at(*k)).count() as u64);
        assert!(of("mag_1_uc", "polar_dead_zone").is_none() && of("mag_1_uc", "lag").is_none());
    }

    /// Whether the field of the test above is along x.
    fn lost_at(k: usize) -> bool {
        (0.4 * (k as f64 * 0.1)).cos().abs() * 50_000.0 > 45_000.0
    }
}
