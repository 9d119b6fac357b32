//! Initial estimate and covariance of a filter at the first sample of a line.

use arrow_array::{RecordBatch, cast::AsArray};
use numerics::{
    navigation::{
        ins_error::{InsErrorModel, InsErrors, StartFix, StartFixSigmas, aligned_covariance},
        ins_series::InsSeries,
        pinson::StateMatrix,
    },
    random::NormalGenerator,
};
use schemas::{
    Fault, Role, Rule, TableShape, choice,
    flight::{GNSS_POSITION, GNSS_VELOCITY, INS_GRADE},
    params,
};

use super::Navigate;
use crate::columns::{faults_of, floats, role_of};

choice! {
    /// Source of the initial estimate of a filter.
    pub enum StartSource {
        /// `given` if an initial position, height or velocity key is set. Otherwise `fix` if `fix` is set or the flight
        /// has the columns of a GNSS receiver (`gnss_lat`, `gnss_lon`, `gnss_alt`). Otherwise `alignment` if the flight
        /// has the column `ins_aligned`. Otherwise `fix` if the flight has `lat`, `lon` and `alt`. Other flights are
        /// rejected.
        Auto = "auto",
        /// A position and velocity fix corrects the INS at the first sample of the line. The uncertainty of the tilts
        /// and biases of the INS has grown since the alignment, whose time is in the column `ins_aligned`. Without this
        /// column, the alignment is assumed at the fix or one hour before it, whichever gives the larger likelihood of
        /// the innovations. If no likelihood is computed, the alignment is assumed one hour before the fix.
        Fix = "fix",
        /// The initial standard deviations apply at the time of alignment, which is in the column `ins_aligned`. Their
        /// covariance is propagated to the first sample of the line, assuming straight and level flight.
        Alignment = "alignment",
        /// The initial standard deviations apply at the first sample of the line.
        Given = "given",
    }
}

params! {
    /// Initial estimate and covariance at the first sample of a line.
    pub struct StartKeys;
    /// Source of the initial estimate. `fix` corrects the INS with a position fix. `alignment` propagates the `init_*`
    /// standard deviations from the alignment to the start of the line. `given` applies the `init_*` standard
    /// deviations at the start of the line; the defaults are valid only within minutes of the alignment, because an INS
    /// drifts. `auto` selects one of the three from the keys and columns.
    start: StartSource, unit "", default StartSource::Auto;
    /// Columns with the latitude (deg), longitude (deg) and height (m) of the fix. The first values within 2 s of the
    /// line's start are used. If the columns have the role truth, white noise with the fix's standard deviations is
    /// added. The added noise of a line is the same in every run.
    fix: Option<[String; 3]>, unit "",
        absent "`gnss_lat`, `gnss_lon` and `gnss_alt` if the flight has them, else `lat`, `lon` and `alt`";
    /// Columns of the fix's velocity components: north, east and down.
    fix_velocity: Option<[String; 3]>, unit "m/s",
        absent "`gnss_vn`, `gnss_ve` and `gnss_vd` for a fix from `gnss_*` columns, otherwise `vn`, `ve` and `vd`; \
            without these columns, the velocity of the INS";
    /// Standard deviation of the fix's position along each horizontal axis.
    fix_sigma_m: f64, unit "m", default 3.0, rule Rule::Positive;
    /// Standard deviation of the fix's height.
    fix_alt_sigma_m: f64, unit "m", default 5.0, rule Rule::Positive;
    /// Standard deviation of each component of the fix's velocity.
    fix_velocity_sigma_mps: f64, unit "m/s", default 0.1, rule Rule::Positive;
}

/// Column with the time of the last alignment of the INS.
pub(super) const ALIGNED: &str = "ins_aligned";
const TRUTH: [&str; 3] = ["lat", "lon", "alt"];
const TRUE_VELOCITY: [&str; 3] = ["vn", "ve", "vd"];
/// Longest time from the start of a line to the position and velocity fix of the line, in seconds.
const FIX_WITHIN_S: f64 = 2.0;
/// Possible times from an alignment at an unknown time to the fix, in seconds: for an old alignment, and for an
/// alignment at the fix. Within an hour, about two thirds of a Schuler period, the tilts reach their largest errors.
const ASSUMED_AGES_S: [f64; 2] = [3600.0, 0.0];
/// Longest time from an alignment to a line, in seconds.
const LONGEST_AGE_S: f64 = 2.0 * 86_400.0;

/// Initial condition of the filter of a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum InitialCondition {
    /// The initial standard deviations.
    Given,
    /// The alignment, and the time since then.
    Aligned {
        /// Time since the alignment, in seconds.
        age_s: f64,
    },
    /// A fix at a row.
    Fixed {
        /// Fix.
        fix: StartFix,
        /// Row of the fix.
        row: usize,
        /// Time from the alignment to the fix, in seconds; `None` if it is unknown.
        age_s: Option<f64>,
    },
}

/// Whether a flight has all of these columns.
fn has(shape: &TableShape, names: &[&str]) -> bool {
    names.iter().all(|name| shape.get(name).is_some())
}

/// Columns of a GNSS position: the columns of the receiver if the flight has them, else the position of the flight.
pub(super) fn gnss_columns(given: Option<&[String; 3]>, shape: &TableShape) -> [String; 3] {
    let usual = if has(shape, &GNSS_POSITION) { GNSS_POSITION } else { TRUTH };
    given.cloned().unwrap_or_else(|| usual.map(str::to_owned))
}

impl Navigate {
    /// Source of the initial estimate on flights with these columns.
    pub(super) fn start_from(&self, shape: &TableShape) -> Result<StartSource, Fault> {
        let chosen = match self.start.start {
            StartSource::Auto if !self.is_auto() || self.ins.start_given => StartSource::Given,
            StartSource::Auto if self.start.fix.is_some() || has(shape, &GNSS_POSITION) => StartSource::Fix,
            StartSource::Auto if shape.number(ALIGNED, "s").is_ok() => StartSource::Alignment,
            StartSource::Auto if has(shape, &TRUTH) => StartSource::Fix,
            StartSource::Auto => {
                let what = "the accuracy of the INS at the start of a line is unknown";
                let help = "set `start = \"fix\"`, and `fix` to the columns of a position; or append the column \
                            `ins_aligned` with `derive`: the time of the last alignment, in seconds past midnight; or \
                            set `start = \"given\"`, `init_position_sigma_m` and `init_velocity_sigma_mps`";
                return Err(Fault::new(what).help(help).of_param("start"));
            }
            given => given,
        };
        match chosen {
            StartSource::Alignment => {
                let help = "append the column `ins_aligned` with `derive`: the time of the last alignment, in seconds \
                            past midnight";
                shape.number(ALIGNED, "s").map_err(|fault| fault.of_param("start").help(help))?;
            }
            StartSource::Given if self.ins.sources.init_position_sigma_m == 0.0 => {
                let what = "`init_position_sigma_m` is 0, but the position of an INS is exact only at its alignment";
                let help = "set `start = \"alignment\"` with a column `ins_aligned`, or set `init_position_sigma_m`";
                return Err(Fault::new(what).help(help).of_param("init_position_sigma_m"));
            }
            _ => {}
        }
        Ok(chosen)
    }

    /// Faults of the columns of the initial estimate.
    pub(super) fn start_faults(&self, shape: &TableShape) -> Vec<Fault> {
        match self.start_from(shape) {
            Err(fault) => vec![fault],
            Ok(StartSource::Fix) => {
                let columns = self.fix_columns(shape);
                let position = columns.iter().zip(["deg", "deg", "m"]).map(|(name, unit)| shape.number(name, unit));
                let mut faults = faults_of(position, "fix");
                if let Some(velocity) = &self.start.fix_velocity {
                    faults.extend(faults_of(velocity.iter().map(|name| shape.number(name, "m/s")), "fix_velocity"));
                }
                faults
            }
            Ok(_) => vec![],
        }
    }

    /// The columns of the fix's position.
    fn fix_columns(&self, shape: &TableShape) -> [String; 3] {
        gnss_columns(self.start.fix.as_ref(), shape)
    }

    /// The columns of the fix's velocity.
    fn velocity_columns(&self, shape: &TableShape) -> Option<[String; 3]> {
        let usual = if self.fix_columns(shape) == GNSS_POSITION { GNSS_VELOCITY } else { TRUE_VELOCITY };
        let usual = has(shape, &usual).then(|| usual.map(str::to_owned));
        self.start.fix_velocity.clone().or(usual)
    }

    /// Whether the error sources of the INS come from the flight's column [`INS_GRADE`]. This is the case if no key of
    /// the INS is set and the initial standard deviations apply at the alignment.
    pub(super) fn takes_grade(&self, shape: &TableShape) -> bool {
        let start = self.start_from(shape);
        let at_alignment = matches!(start, Ok(StartSource::Alignment | StartSource::Fix));
        self.is_auto() && !self.ins.given && shape.get(INS_GRADE).is_some() && at_alignment
    }

    /// Error sources of the INS of a line.
    pub(super) fn ins_sources(&self, batch: &RecordBatch) -> Result<InsErrors, Fault> {
        if !self.takes_grade(&TableShape::from_schema(&batch.schema())) {
            return Ok(self.ins.sources);
        }
        let texts = batch.column_by_name(INS_GRADE).and_then(|column| column.as_string_opt::<i32>());
        let Some(text) = texts.and_then(|texts| texts.iter().flatten().next()) else { return Ok(self.ins.sources) };
        InsErrors::from_description(text).map_err(|fault| {
            let help = "give a grade, such as `tactical`, or set `ins_grade` in the spec";
            Fault::data(fault.what).in_column(INS_GRADE).help(fault.help.unwrap_or_else(|| help.to_owned()))
        })
    }

    /// Columns that the initial estimate requires.
    pub(super) fn start_reads(&self, shape: &TableShape) -> Vec<String> {
        let grade = self.takes_grade(shape).then(|| INS_GRADE.to_owned());
        let aligned = has(shape, &[ALIGNED]).then(|| ALIGNED.to_owned());
        match self.start_from(shape) {
            Ok(StartSource::Alignment) => aligned.into_iter().chain(grade).collect(),
            Ok(StartSource::Fix) => {
                let columns =
                    self.fix_columns(shape).into_iter().chain(self.velocity_columns(shape).into_iter().flatten());
                columns.chain(aligned).chain(grade).collect()
            }
            Ok(_) | Err(_) => vec![],
        }
    }

    /// Note on the chosen initial estimate.
    pub(super) fn start_note(&self, shape: &TableShape) -> Option<String> {
        if self.start.start != StartSource::Auto || !self.is_auto() {
            return None;
        }
        let fix = || self.fix_columns(shape).map(|name| format!("`{name}`")).join(", ");
        match self.start_from(shape).ok()? {
            StartSource::Alignment => Some(format!("filters start from the alignment at `{ALIGNED}`")),
            StartSource::Fix if has(shape, &[ALIGNED]) => {
                Some(format!("filters start from a fix ({}) at the first sample of each line", fix()))
            }
            StartSource::Fix => Some(format!(
                "filters start from a fix ({}) at the first sample of each line; the flight has no column `{ALIGNED}`, \
                 so the likelihood chooses an alignment of the INS at the fix or one hour before",
                fix()
            )),
            StartSource::Given => {
                Some("filters start with the `init_*` keys at the first sample of each line".to_owned())
            }
            StartSource::Auto => None,
        }
    }

    /// Initial condition of the filter of a line.
    pub(super) fn begin(&self, batch: &RecordBatch) -> Result<InitialCondition, Fault> {
        let shape = TableShape::from_schema(&batch.schema());
        let tt_s = floats(batch, "tt")?;
        let first_s = tt_s.first().copied().unwrap_or_default();
        match self.start_from(&shape)? {
            StartSource::Alignment => Ok(InitialCondition::Aligned { age_s: age_s(batch, first_s)? }),
            StartSource::Fix => self.fixed(batch, &shape, tt_s),
            StartSource::Auto | StartSource::Given => Ok(InitialCondition::Given),
        }
    }

    fn fixed(&self, batch: &RecordBatch, shape: &TableShape, tt_s: &[f64]) -> Result<InitialCondition, Fault> {
        let StartKeys { fix_sigma_m, fix_alt_sigma_m, fix_velocity_sigma_mps, .. } = &self.start;
        let fix = self.fix_columns(shape);
        let sigmas = StartFixSigmas {
            horizontal_m: *fix_sigma_m,
            vertical_m: *fix_alt_sigma_m,
            velocity_mps: *fix_velocity_sigma_mps,
        };
        let velocity = self.velocity_columns(shape);
        let mut columns = vec![];
        for name in fix.iter().chain(velocity.iter().flatten()) {
            columns.push(floats(batch, name)?);
        }
        let first_s = tt_s.first().copied().unwrap_or_default();
        let there = |row: &usize| columns.iter().all(|column| column[*row].is_finite());
        let within = |row: &usize| tt_s[*row] - first_s <= FIX_WITHIN_S;
        let Some(row) = (0..tt_s.len()).take_while(within).find(there) else {
            let what = format!("no row within {FIX_WITHIN_S} s of the line's start has a position for the fix");
            let help = "set `fix` to other columns, or set another `start`";
            return Err(Fault::data(what).in_column(&fix[0]).help(help));
        };
        let mut values: Vec<f64> = columns.iter().map(|column| column[row]).collect();
        let names: Vec<&String> = fix.iter().chain(velocity.iter().flatten()).collect();
        if role_of(shape, &names) == Role::Truth {
            let mut normals = NormalGenerator::new(values[0].to_bits() ^ first_s.to_bits());
            let (north_m, east_m) =
                InsErrorModel::default().earth.north_east_m_per_rad(values[0].to_radians(), values[2]);
            let of_degrees = |m_per_rad: f64| (sigmas.horizontal_m / m_per_rad).to_degrees();
            let speeds = [sigmas.velocity_mps; 3];
            let sigmas = [of_degrees(north_m), of_degrees(east_m), sigmas.vertical_m].into_iter().chain(speeds);
            for ((value, name), sigma) in values.iter_mut().zip(&names).zip(sigmas) {
                let error = sigma * normals.draw();
                if role_of(shape, &[name]) == Role::Truth {
                    *value += error;
                }
            }
        }
        let vel_ned_mps = velocity.is_some().then(|| [values[3], values[4], values[5]]);
        let fix = StartFix { lat_lon_deg: [values[0], values[1]], alt_m: values[2], vel_ned_mps, sigmas };
        let age_s = has(shape, &[ALIGNED]).then(|| age_s(batch, tt_s[row])).transpose()?;
        Ok(InitialCondition::Fixed { fix, row, age_s })
    }
}

/// Time from the last alignment of the INS to a time `at_s` of the line, in seconds.
fn age_s(batch: &RecordBatch, at_s: f64) -> Result<f64, Fault> {
    let aligned = floats(batch, ALIGNED)?.first().copied().unwrap_or(f64::NAN);
    let age_s = at_s - aligned;
    // Half a millisecond allows for the rounding of time stamps.
    if !(-5e-4..=LONGEST_AGE_S).contains(&age_s) {
        let what = format!("the INS was aligned at {aligned} s, but the line begins at {at_s} s");
        let help = "give both in seconds past midnight UTC of the day of take-off";
        return Err(Fault::data(what).in_column(ALIGNED).help(help));
    }
    Ok(age_s.max(0.0))
}

impl InitialCondition {
    /// Covariances of the state at the first sample: one, or one for each possible time of an unknown alignment, the
    /// largest first. The list is empty if the initial standard deviations apply.
    pub(super) fn covariances(&self, errors: &InsErrorModel, ins: &InsSeries<'_>) -> Vec<StateMatrix> {
        match self {
            InitialCondition::Given => vec![],
            InitialCondition::Aligned { age_s } => vec![aligned_covariance(errors, ins, *age_s)],
            InitialCondition::Fixed { fix, row, age_s } => {
                let known = age_s.map(|age_s| [age_s]);
                let ages_s = known.as_ref().map_or(ASSUMED_AGES_S.as_slice(), <[f64; 1]>::as_slice);
                let at = |age_s: &f64| aligned_covariance(errors, &ins.from(*row), *age_s);
                ages_s.iter().map(|age_s| fix.covariance(errors, Some(&at(age_s)))).collect()
            }
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::sync::Arc;

    use arrow_array::{ArrayRef, StringArray};
    use arrow_schema::{Field, Schema};
    use schemas::Column;

    use super::*;
    use crate::{
        columns::array,
        navigate::testing::{NavigateOutput, ROWS, flight, flown_on, numbers_of, with},
    };

    /// Keys of the tests without the keys of the INS. The source of the initial estimate then follows from the columns.
    const KEYS: &str = "tuning = 'auto'\nmag = 'mag_1_c'\ncore_field = false";

    /// The flight with further columns.
    fn added(columns: Vec<(&str, &str, ArrayRef)>) -> RecordBatch {
        let flight = flight();
        let mut fields: Vec<_> = flight.schema().fields().iter().map(|field| field.as_ref().clone()).collect();
        let mut arrays = flight.columns().to_vec();
        for (name, unit, values) in columns {
            let column = if unit.is_empty() { Column::text(name, "") } else { Column::float(name, unit, "") };
            fields.push(column.field());
            arrays.push(values);
        }
        RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays).unwrap()
    }

    fn aligned(at_s: f64) -> (&'static str, &'static str, ArrayRef) {
        (ALIGNED, "s", array(vec![at_s; ROWS]))
    }

    fn grade(text: &str) -> (&'static str, &'static str, ArrayRef) {
        (INS_GRADE, "", Arc::new(StringArray::from(vec![text; ROWS])))
    }

    /// Positions of a receiver, 4 m north of the truth; the first sample has none.
    fn receiver() -> Vec<(&'static str, &'static str, ArrayRef)> {
        let of = |name: &str, offset: f64| {
            let values = numbers_of(&flight(), name).into_iter().enumerate();
            array(values.map(|(row, x)| if row == 0 { f64::NAN } else { x + offset }).collect())
        };
        let deg = 4.0 / 111_130.0;
        vec![
            ("gnss_lat", "deg", of("lat", deg)),
            ("gnss_lon", "deg", of("lon", 0.0)),
            ("gnss_alt", "m", of("alt", 0.0)),
        ]
    }

    fn run(keys: &str, flight: &RecordBatch) -> Result<NavigateOutput, Fault> {
        flown_on("ins_only", &format!("{KEYS}\n{keys}"), flight)
    }

    #[test]
    fn unit_a_filter_starts_from_the_receiver_of_a_flight() {
        // A start from the alignment keeps the INS error of 10 m; a start from the receiver has the receiver's error of
        // 4 m.
        let far = |flight: &RecordBatch, keys: &str| run(keys, flight).unwrap().error_m(0);
        let of_alignment = far(&added(vec![aligned(-100.0)]), "");
        let both = added(receiver().into_iter().chain([aligned(-100.0)]).collect());
        assert!((of_alignment - 10.0).abs() < 0.1, "{of_alignment}");
        assert!((far(&both, "") - 4.0).abs() < 0.3 && (far(&both, "start = 'alignment'") - 10.0).abs() < 0.1);
        // The tilt has grown since an old alignment, so the position error grows faster.
        let spread = |age_s: f64| {
            let flight = added(receiver().into_iter().chain([aligned(-age_s), grade("tactical")]).collect());
            run("", &flight).unwrap().numbers("sd_n")[ROWS - 1]
        };
        assert!(spread(3000.0) > 2.0 * spread(0.0), "{} {}", spread(3000.0), spread(0.0));
        // An alignment at an unknown time is assumed to be an hour old.
        let unknown = added(receiver().into_iter().chain([grade("tactical")]).collect());
        let assumed = run("", &unknown).unwrap().numbers("sd_n")[ROWS - 1];
        // The fix is at the second sample.
        assert!((assumed / spread(3600.0) - 1.0).abs() < 1e-3, "{assumed} {}", spread(3600.0));
    }

    #[test]
    fn bug_noise_is_added_to_the_truth_columns_of_a_fix_only() {
        let speeds = [("doppler_n", 55.0), ("doppler_e", 0.0), ("doppler_d", 0.0)];
        let column = |(name, speed): (&'static str, f64)| -> (&'static str, &'static str, ArrayRef) {
            (name, "m/s", array(vec![speed; ROWS]))
        };
        let flight = added(speeds.map(column).to_vec());
        let truth = |field: &Arc<Field>| {
            let mut metadata = field.metadata().clone();
            if TRUTH.contains(&field.name().as_str()) {
                metadata.insert("role".to_owned(), "truth".to_owned());
            }
            field.as_ref().clone().with_metadata(metadata)
        };
        let fields: Vec<Field> = flight.schema().fields().iter().map(truth).collect();
        let flight = RecordBatch::try_new(Arc::new(Schema::new(fields)), flight.columns().to_vec()).unwrap();
        let keys = "start = 'fix'\nfix = ['lat', 'lon', 'alt']\nfix_velocity = ['doppler_n', 'doppler_e', \
                    'doppler_d']\n\
                    fix_sigma_m = 20.0\nfix_velocity_sigma_mps = 100.0";
        let found = run(keys, &flight).unwrap();
        assert!(found.error_m(0) > 1.0, "the position is truth: {}", found.error_m(0));
        assert!((found.numbers("vn")[0] - 55.0).abs() < 1.0, "{}", found.numbers("vn")[0]);
    }

    #[test]
    fn unit_a_column_gives_the_error_sources_of_the_ins() {
        let spread = |columns, keys: &str| run(keys, &added(columns)).unwrap().numbers("sd_n")[ROWS - 1];
        let own = |text: &str| vec![aligned(0.0), grade(text)];
        let tactical = spread(vec![aligned(0.0)], "ins_grade = 'tactical'");
        // An accelerometer bias of 9.8e-3 m/s² exceeds the effect of an initial tilt of 0.01°, which is 1.7e-3 m/s².
        let magnav = spread(vec![aligned(0.0)], "");
        assert!(tactical > 3.0 * magnav, "{tactical} {magnav}");
        assert_eq!(spread(own("tactical"), ""), tactical);
        // A key of the spec replaces the column.
        assert_eq!(spread(own("tactical"), "ins_grade = 'magnav'"), spread(vec![aligned(0.0)], ""));
        assert_eq!(spread(own("tactical"), "tuning = 'magnav'\nstart = 'alignment'"), spread(vec![aligned(0.0)], ""));
        assert!(spread(own("tactical, acc_sigma_mps2 = 0.1"), "") > 2.0 * tactical);
        let fault = run("", &added(own("tactcal"))).unwrap_err();
        assert_eq!(fault.place.column.as_deref(), Some(INS_GRADE));
        assert!(fault.what.contains("tactcal"), "{fault:?}");
    }

    #[test]
    fn unit_a_flight_without_a_start_is_rejected() {
        let lost = with(&flight(), "lat", |_, _| f64::NAN);
        let fault = run("", &lost).unwrap_err();
        assert!(fault.what.contains("no row within 2 s"), "{fault:?}");
    }
}
