//! Simulated INS of a flight.

use std::sync::Arc;

use arrow_array::{ArrayRef, RecordBatch, StringArray};
use numerics::{
    navigation::{
        ins_error::{
            InsErrorModel, InsErrorSpec, MechanisationErrors, NormalStreams, errors_along, faulty_ins, horizontal_m,
            mechanised_errors_along,
        },
        ins_series::InsSeries,
        pinson::StateVector,
        strapdown,
    },
    random::{NormalGenerator, seed_of},
    signal::local_fit::smoothed,
};
use schemas::{
    Column, Fault, LineInput, LineOutput, LineStage, Rule, Stage, StageSchema, Table, TableShape, choice,
    flight::{self, INS_GRADE},
    stage,
};

use crate::columns::{array, data, faults_of, floats, shape};

stage! {
    /// Simulates an INS of a given grade: the GNSS track plus simulated errors. The simulated INS data are added to the
    /// flight, or replace its INS data. The stage appends `ins_lat`, `ins_lon`, `ins_alt`, `ins_vn`, `ins_ve`,
    /// `ins_vd`, `ins_fn`, `ins_fe`, `ins_fd`, `ins_roll`, `ins_pitch`, `ins_yaw`, `ins_aligned` and `ins_grade`.
    /// `navigate` reads these columns like measured columns.
    ///
    /// The true position is `lat`, `lon` and `alt`. The velocity is used if `vn`, `ve` and `vd` exist, and the attitude
    /// if `roll`, `pitch` and `yaw` exist. Missing velocities are derived from the positions, and specific forces from
    /// the velocities. If the attitude is missing, the aircraft is assumed to be level, with the yaw along the course.
    /// Derivatives amplify the noise of a GNSS receiver, and the specific force is a second derivative. Positions and
    /// velocities are therefore first smoothed over `smooth_s`. Apart from the effect of smoothing, the INS data then
    /// contain only INS errors and no receiver noise.
    ///
    /// Each line begins with a new alignment with random errors, whose standard deviations are the `init_*` keys. All
    /// simulated errors depend only on `seed` and the names of flight and line. Lines with the same seed and names have
    /// the same INS errors on every machine. Samples need not be evenly spaced. One seed gives one realisation; sweep
    /// `seed` for the statistics of a grade.
    ///
    /// The stage rejects a NaN in position, velocity or attitude, times that do not increase, a line of one sample, and
    /// an INS error above 1,000 km. Existing INS data are rejected unless `replace = true`.
    ///
    /// Source: Gnadt 2022, (5.15) to (5.35); Titterton & Weston 2004, chapter 12; grades: Lee 2019, Tables 9 and 10.
    SimulateIns = "simulate_ins", version 3, grain Line, inputs [input: Lines], groups [ins: InsErrorSpec],
    example r#"
[[stages]]
name      = "simulate_ins"
stage     = "simulate_ins"
input     = "resample"
ins_grade = "navigation"
replace   = true
"#;
    /// Propagation of the errors: the linear error model of `navigate`, or a strapdown mechanisation of sensor readings
    /// with errors. The mechanisation is accurate for errors of any size.
    method: ErrorPropagation, unit "", default ErrorPropagation::ErrorModel;
    /// Length of the window in which positions and velocities are smoothed by fitted parabolas. The weights fall to 0
    /// at the ends of the window. 0 switches smoothing off.
    smooth_s: f64, unit "s", default 5.0, rule Rule::NotNegative;
    /// Seed of all random draws.
    seed: usize, unit "", default 0usize;
    /// Replaces existing INS data of the flight.
    replace: bool, unit "", default false;
}

choice! {
    /// Propagation of the errors.
    pub enum ErrorPropagation {
        /// The linear error model.
        ErrorModel = "error_model",
        /// A strapdown mechanisation.
        Mechanisation = "mechanisation",
    }
}

const POSITION: [(&str, &str); 3] = [("lat", "deg"), ("lon", "deg"), ("alt", "m")];
const VELOCITY: [(&str, &str); 3] = [("vn", "m/s"), ("ve", "m/s"), ("vd", "m/s")];
const ATTITUDE: [(&str, &str); 3] = [("roll", "deg"), ("pitch", "deg"), ("yaw", "deg")];

/// Columns that the stage makes: the columns of [`faulty_ins`] in the same order, and the time of the alignment.
const MADE: [&str; 13] = [
    "ins_lat",
    "ins_lon",
    "ins_alt",
    "ins_vn",
    "ins_ve",
    "ins_vd",
    "ins_fn",
    "ins_fe",
    "ins_fd",
    "ins_roll",
    "ins_pitch",
    "ins_yaw",
    "ins_aligned",
];

/// Largest position error for which an error model or a map is valid, in metres.
const ERROR_LIMIT_M: f64 = 1e6;

impl SimulateIns {
    /// Columns that are read. A group is read completely or not at all.
    fn reads(shape: &TableShape) -> Vec<(&'static str, &'static str)> {
        let there = |group: &&[(&str, &str); 3]| group.iter().all(|(name, _)| shape.get(name).is_some());
        POSITION.into_iter().chain([&VELOCITY, &ATTITUDE].into_iter().filter(there).copied().flatten()).collect()
    }

    /// Fault of an existing INS without `replace = true`.
    fn kept(&self, shape: &TableShape) -> Option<Fault> {
        let have =
            MADE.into_iter().chain([INS_GRADE]).find(|name| shape.get(name).is_some()).filter(|_| !self.replace)?;
        let what = format!("the flight already has an INS: `{have}`");
        Some(
            Fault::new(what)
                .help("set `replace = true` to replace these columns by the simulated INS")
                .of_param("replace"),
        )
    }

    fn model(&self) -> InsErrorModel {
        InsErrorModel { fogm_sigma_nt: 0.0, ..InsErrorModel::from_sources(self.ins.sources) }
    }

    /// Realisation of the INS error along a line: truth minus INS, one value per sample.
    fn errors(&self, truth: &InsSeries, line: &LineInput) -> Result<Vec<StateVector>, Fault> {
        let normals = |what| NormalGenerator::new(seed_of(self.seed as u64, &[&line.flight, &line.line, what]));
        let (mut block, mut within) = (normals("ins"), normals("ins within a second"));
        let model = self.model();
        let draws = &mut NormalStreams { block: &mut || block.draw(), within: &mut || within.draw() };
        let start = model.initial_error(truth.lat_deg[0].to_radians(), truth.alt_m[0], draws.block);
        let errors = match self.method {
            ErrorPropagation::ErrorModel => errors_along(truth, &model, &start, draws),
            ErrorPropagation::Mechanisation => {
                mechanised_errors_along(truth, &model, &MechanisationErrors::default(), &start, draws)
            }
        };
        errors.map_err(data)
    }
}

/// True motion along a line: smoothed, with missing columns derived.
struct TrueMotion<'a> {
    tt_s: &'a [f64],
    columns: [Vec<f64>; 12],
}

impl<'a> TrueMotion<'a> {
    fn new(batch: &'a RecordBatch, smooth_s: f64) -> Result<TrueMotion<'a>, Fault> {
        let tt_s = floats(batch, "tt")?;
        let read = |columns: [(&'static str, &str); 3]| -> Result<Option<[Vec<f64>; 3]>, Fault> {
            if columns.iter().any(|(name, _)| batch.column_by_name(name).is_none()) {
                return Ok(None);
            }
            let [a, b, c] = columns.map(|(name, _)| known(batch, name));
            Ok(Some([a?.to_vec(), b?.to_vec(), c?.to_vec()]))
        };
        let smooth = |x: Vec<f64>| if smooth_s > 0.0 { smoothed(tt_s, &x, smooth_s) } else { x };
        let [lat, lon, alt] = read(POSITION)?.ok_or_else(|| Fault::data("the line has no positions"))?;
        let series = |e| named(e, "lat");
        // The velocity is computed to reject times that do not ascend, because smoothing requires ascending times.
        // Longitudes are unwrapped, because they may pass 180 degrees.
        strapdown::velocity_ned_mps(tt_s, &lat, &lon, &alt).map_err(series)?;
        let (lat, lon, alt) = (smooth(lat), smooth(numerics::angle::unwrapped_deg(&lon)), smooth(alt));
        let [vn, ve, vd] = match read(VELOCITY)? {
            Some(velocity) => velocity.map(smooth),
            None => strapdown::velocity_ned_mps(tt_s, &lat, &lon, &alt).map_err(series)?,
        };
        let force = strapdown::specific_force_ned_mps2(tt_s, [&lat, &alt], [&vn, &ve, &vd]).map_err(series)?;
        let [roll, pitch, yaw] = match read(ATTITUDE)? {
            Some(attitude) => attitude,
            None => strapdown::level_attitude_deg(&vn, &ve).map_err(series)?,
        };
        let [force_n, force_e, force_d] = force;
        Ok(TrueMotion { tt_s, columns: [lat, lon, alt, vn, ve, vd, force_n, force_e, force_d, roll, pitch, yaw] })
    }

    fn series(&self) -> InsSeries<'_> {
        let [lat, lon, alt, vn, ve, vd, force_n, force_e, force_d, roll, pitch, yaw] =
            self.columns.each_ref().map(Vec::as_slice);
        InsSeries::from_columns([self.tt_s, lat, lon, alt, vn, ve, vd, force_n, force_e, force_d, roll, pitch, yaw])
    }
}

/// A column without gaps.
fn known<'a>(batch: &'a RecordBatch, name: &str) -> Result<&'a [f64], Fault> {
    let column = floats(batch, name)?;
    match column.iter().position(|x| !x.is_finite()) {
        None => Ok(column),
        Some(row) => Err(Fault::data("the truth has a gap, but a simulated INS requires a truth at every sample")
            .in_column(name)
            .in_row(row as u64)
            .help("fill short gaps with `resample` (`max_gap_s`), and split a line at long ones")),
    }
}

/// Fault of times or positions.
fn named(e: numerics::navigation::ins_series::SeriesError, lat: &str) -> Fault {
    use numerics::navigation::ins_series::SeriesError as E;
    match e {
        E::Time { row, .. } => {
            data(e).in_column("tt").in_row(row as u64).help("add a `resample` stage before this one")
        }
        E::Latitude { row, .. } => data(e).in_column(lat).in_row(row as u64),
        E::TooShort { .. } | E::Length { .. } | E::NotFinite { .. } => data(e),
    }
}

/// Rejects an INS with an error above the limit.
fn check_limit(truth: &InsSeries, errors: &[StateVector]) -> Result<(), Fault> {
    let off_m = |row: usize| horizontal_m(&errors[row], truth.lat_deg[row].to_radians(), truth.alt_m[row]);
    let beyond = (0..errors.len()).find(|row| off_m(*row).is_nan() || off_m(*row) > ERROR_LIMIT_M);
    beyond.map_or(Ok(()), |row| {
        let since_s = truth.tt_s[row] - truth.tt_s[0];
        let what = format!("the error of the simulated INS exceeds 1,000 km after {since_s:.0} s");
        let help =
            "set a better `ins_grade`, or use shorter lines: a `commercial` INS is usable for one or two minutes";
        Err(Fault::data(what).in_row(row as u64).help(help))
    })
}

impl Stage for SimulateIns {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let reads = SimulateIns::reads(shape);
        let mut faults = faults_of(reads.iter().map(|(name, unit)| shape.number(name, unit)), "input");
        faults.extend(self.kept(shape));
        if !faults.is_empty() {
            return Err(faults);
        }
        let reads: Vec<&str> = ["tt"].into_iter().chain(reads.into_iter().map(|(name, _)| name)).collect();
        let made = |name: &str| {
            let known = flight::describe(name);
            Column::float(name, known.unit, format!("simulated {}", known.description)).from(0, &reads)
        };
        let grade = Column::text(INS_GRADE, flight::describe(INS_GRADE).description);
        let mut yields = StageSchema::append(MADE.map(made).into_iter().chain([grade]).collect(), &reads);
        for (three, from) in [(VELOCITY, "the positions"), (ATTITUDE, "the course, level")] {
            if !reads.contains(&three[0].0) {
                let names = three.map(|(name, _)| name).join(", ");
                yields.notes.push(format!("{names} missing: the truth is derived from {from}"));
            }
        }
        Ok(yields)
    }
}

impl LineStage for SimulateIns {
    type Prepared = ();

    fn run(&self, line: &LineInput, (): &()) -> LineOutput {
        let truth = TrueMotion::new(&line.inputs[0], self.smooth_s)?;
        let series = truth.series();
        let errors = self.errors(&series, line)?;
        check_limit(&series, &errors)?;
        let aligned = vec![series.tt_s[0]; series.len()];
        let ins = faulty_ins(&series, &errors, [0.0; 3]);
        let grade = self.ins.sources.description();
        let grade: ArrayRef = Arc::new(StringArray::from_iter_values(std::iter::repeat_n(grade, series.len())));
        Ok(ins.into_iter().chain([aligned]).map(array).chain([grade]).collect())
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests;
