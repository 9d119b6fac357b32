//! Initial estimate and covariance of a filter at the first sample of a line.

use arrow_array::RecordBatch;
use numerics::{
    navigation::{
        ins_error::{InsErrorModel, StartFix, StartFixSigmas, aligned_covariance},
        ins_series::InsSeries,
        pinson::StateMatrix,
    },
    random::NormalGenerator,
};
use schemas::{Fault, Role, Rule, TableShape, choice, params};

use super::Navigate;
use crate::columns::{faults_of, floats, role_of};

choice! {
    /// Source of the initial estimate of a filter.
    pub enum StartSource {
        /// `given` if an initial position, height or velocity key is set; otherwise `alignment` if the flight has the
        /// column `ins_aligned`; otherwise `fix` if the flight has the columns of `fix`. Other flights are rejected.
        Auto = "auto",
        /// A position and velocity fix corrects the INS at the first sample of the line.
        Fix = "fix",
        /// The initial standard deviations apply at the alignment, at the time in the column `ins_aligned`. The
        /// covariance of the fix is propagated to the first sample of the line, assuming straight and level flight.
        Alignment = "alignment",
        /// The initial standard deviations apply at the first sample of the line.
        Given = "given",
    }
}

params! {
    /// Initial estimate and covariance at the first sample of a line.
    pub struct StartKeys;
    /// Source of the initial estimate. An INS drifts after its alignment, so the `init_*` keys are not valid minutes
    /// later.
    start: StartSource, unit "", default StartSource::Auto;
    /// Columns of latitude, longitude (deg) and height (m) of the fix. The first values within 2 s of the line's start
    /// are used. White noise with the fix's standard deviations is added to columns with the role truth. It is
    /// reproducible for each line.
    fix: [String; 3], unit "", default ["lat", "lon", "alt"].map(str::to_owned);
    /// Columns of the fix's velocity north, east and down.
    fix_velocity: Option<[String; 3]>, unit "m/s",
        absent "`vn`, `ve` and `vd` if the flight has them, else the velocity of the INS";
    /// Standard deviation of the fix's position in each of north and east.
    fix_sigma_m: f64, unit "m", default 3.0, rule Rule::Positive;
    /// Standard deviation of the fix's height.
    fix_alt_sigma_m: f64, unit "m", default 5.0, rule Rule::Positive;
    /// Standard deviation of each component of the fix's velocity.
    fix_velocity_sigma_mps: f64, unit "m/s", default 0.1, rule Rule::Positive;
}

/// Column with the time of the last alignment of the INS.
pub(super) const ALIGNED: &str = "ins_aligned";
const VELOCITY: [&str; 3] = ["vn", "ve", "vd"];
/// Longest time from the start of a line to the position and velocity fix of the line, in s.
const FIX_WITHIN_S: f64 = 2.0;
/// Longest time from an alignment to a line, in s.
const LONGEST_AGE_S: f64 = 2.0 * 86_400.0;

/// Initial condition of the filter of a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum InitialCondition {
    /// The initial standard deviations.
    Given,
    /// The alignment, and the time since then.
    Aligned {
        /// Time since the alignment, in s.
        age_s: f64,
    },
    /// A fix at a row.
    Fixed {
        /// Fix.
        fix: StartFix,
        /// Row of the fix.
        row: usize,
    },
}

impl Navigate {
    /// Source of the initial estimate on flights of this shape.
    pub(super) fn start_from(&self, shape: &TableShape) -> Result<StartSource, Fault> {
        let chosen = match self.start.start {
            StartSource::Auto if !self.is_auto() || self.ins.start_given => StartSource::Given,
            StartSource::Auto if shape.number(ALIGNED, "s").is_ok() => StartSource::Alignment,
            StartSource::Auto if self.start.fix.iter().all(|column| shape.get(column).is_some()) => StartSource::Fix,
            StartSource::Auto => {
                let what = "the accuracy of the INS at the start of a line is unknown";
                let help = "set `start = \"fix\"` and `fix` to the columns of a position; or append `ins_aligned`, the time \
                            of the last alignment (seconds past midnight, by `derive`); or set `start = \"given\"`, \
                            `init_position_sigma_m` and `init_velocity_sigma_mps`";
                return Err(Fault::new(what).help(help).of_param("start"));
            }
            given => given,
        };
        match chosen {
            StartSource::Alignment => {
                let help = "append the time of the last alignment in seconds past midnight by `derive`";
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
                let position =
                    self.start.fix.iter().zip(["deg", "deg", "m"]).map(|(name, unit)| shape.number(name, unit));
                let mut faults = faults_of(position, "fix");
                if let Some(velocity) = &self.start.fix_velocity {
                    faults.extend(faults_of(velocity.iter().map(|name| shape.number(name, "m/s")), "fix_velocity"));
                }
                faults
            }
            Ok(_) => vec![],
        }
    }

    /// The columns of the fix's velocity.
    fn velocity_columns(&self, shape: &TableShape) -> Option<[String; 3]> {
        let usual = VELOCITY.iter().all(|name| shape.get(name).is_some()).then(|| VELOCITY.map(str::to_owned));
        self.start.fix_velocity.clone().or(usual)
    }

    /// Columns that the initial estimate requires.
    pub(super) fn start_reads(&self, shape: &TableShape) -> Vec<String> {
        match self.start_from(shape) {
            Ok(StartSource::Alignment) => vec![ALIGNED.to_owned()],
            Ok(StartSource::Fix) => {
                self.start.fix.iter().cloned().chain(self.velocity_columns(shape).into_iter().flatten()).collect()
            }
            Ok(_) | Err(_) => vec![],
        }
    }

    /// Note on the chosen initial estimate.
    pub(super) fn start_note(&self, shape: &TableShape) -> Option<String> {
        if self.start.start != StartSource::Auto || !self.is_auto() {
            return None;
        }
        let fix = || self.start.fix.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
        match self.start_from(shape).ok()? {
            StartSource::Alignment => Some(format!("filters start from the alignment at `{ALIGNED}`")),
            StartSource::Fix => Some(format!("filters start from a fix ({}) at the first sample of each line", fix())),
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
            StartSource::Alignment => {
                let aligned = floats(batch, ALIGNED)?.first().copied().unwrap_or(f64::NAN);
                let age_s = first_s - aligned;
                // Half a millisecond allows for the rounding of time stamps.
                if !(-5e-4..=LONGEST_AGE_S).contains(&age_s) {
                    let what = format!("the INS was aligned at {aligned} s, but the line begins at {first_s} s");
                    let help = "give both in seconds past midnight UTC of the day of take-off";
                    return Err(Fault::data(what).in_column(ALIGNED).help(help));
                }
                Ok(InitialCondition::Aligned { age_s: age_s.max(0.0) })
            }
            StartSource::Fix => self.fixed(batch, &shape, tt_s),
            StartSource::Auto | StartSource::Given => Ok(InitialCondition::Given),
        }
    }

    fn fixed(&self, batch: &RecordBatch, shape: &TableShape, tt_s: &[f64]) -> Result<InitialCondition, Fault> {
        let StartKeys { fix, fix_sigma_m, fix_alt_sigma_m, fix_velocity_sigma_mps, .. } = &self.start;
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
            values.iter_mut().zip(sigmas).for_each(|(value, sigma)| *value += sigma * normals.draw());
        }
        let vel_ned_mps = velocity.is_some().then(|| [values[3], values[4], values[5]]);
        let fix = StartFix { lat_lon_deg: [values[0], values[1]], alt_m: values[2], vel_ned_mps, sigmas };
        Ok(InitialCondition::Fixed { fix, row })
    }
}

impl InitialCondition {
    /// Covariance of the state at the first sample; `None` for the initial standard deviations.
    pub(super) fn covariance(&self, errors: &InsErrorModel, ins: &InsSeries<'_>) -> Option<StateMatrix> {
        match self {
            InitialCondition::Given => None,
            InitialCondition::Aligned { age_s } => Some(aligned_covariance(errors, ins, *age_s)),
            InitialCondition::Fixed { fix, .. } => Some(fix.covariance(errors)),
        }
    }
}
