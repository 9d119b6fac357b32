//! What a navigation filter declares of itself, what it is handed and hands back.
//!
//! A filter is one file: its declaration by [`filter!`](crate::filter!), its run, its tests; and one line in [`FILTERS`](super::FILTERS).

use std::{any::Any, sync::Arc};

use arrow_array::{ArrayRef, RecordBatch};
use numerics::{
    earth::core_field::CoreField,
    maps::{map_stack::FieldMap, map_surface::Interpolation},
    navigation::{
        ins_error::InsErrorModel,
        ins_series::InsSeries,
        line::NavigationLine,
        output::{NavigationOutput, NavigationReport},
        pinson::STATES,
        position_fixes::PositionFixes,
        transition::NoiseDiscretisation,
    },
};
use schemas::{Column, Fault, Kind, KindDoc, Own, ParamDoc, Reader, Shape, choice, collect_doc};

use super::{
    Calibration,
    aiding::{Aiding, Gnss},
    tuning::Tuned,
};
use crate::columns::list;

/// A flight line as every filter is handed it.
pub struct Flown<'a> {
    /// The INS, a value a sample; what the flight lacks is derived.
    pub ins: InsSeries<'a>,
    /// The measured field in nT at each sample, less the temporal variation where that is known; NaN where there is
    /// none. It holds the core field if, and only if, `core` is given. Of several magnetometers, their mean.
    pub measured_nt: Vec<f64>,
    /// One sigma of the white noise of each of `measured_nt`, in nT.
    pub sigma_nt: Vec<f64>,
    /// Each magnetometer, for a filter that takes them by themselves ([`NavigationFilter::each_magnetometer`]); else none.
    pub magnetometers: Vec<Magnetometer<'a>>,
    /// The anomaly map, for a filter that needs one ([`NavigationFilter::needs_map`]).
    pub map: Option<&'a FieldMap>,
    /// The core field at the date of the line.
    pub core: Option<Arc<CoreField>>,
    /// The error sources of the INS, and the lasting part of the measurement's error.
    pub errors: InsErrorModel,
    /// The white part of the error of one magnetometer, a sample, in nT.
    pub measurement_sigma_nt: f64,
    /// The length of the window in s, from the first sample, whose mean of measurement minus prediction is taken off;
    /// 0 takes nothing off.
    pub offset_window_s: f64,
    /// The columns that [`NavigationFilter::reads`] names, and those of the INS.
    pub columns: &'a RecordBatch,
    /// The calibrations under `model`.
    pub models: &'a [Calibration],
    /// The vector magnetometer under `vector`, in nT along nose, right and down.
    pub field_nt: Option<[&'a [f64]; 3]>,
    /// The cosine of the angle between the scalar sensor's axis and that field; NaN where it is unknown.
    pub cosines: Option<Vec<f64>>,
    /// What one sigma of a sample's measurement is multiplied by for the attitude; NaN makes it a missing one.
    pub noise_factors: Option<Vec<f64>>,
    /// One sigma of what the measurement of each sample errs by besides, in nT; NaN makes it a missing one.
    pub sample_sigma_nt: Option<Vec<f64>>,
    /// One sigma of what the map errs by at each sample, as white noise, in nT.
    pub map_sigma_nt: Option<Vec<f64>>,
    /// Positions by GNSS, tested, for a filter that takes them ([`NavigationFilter::aiding`]).
    pub gnss: Option<Gnss>,
    /// Counts the curvature of the map over the position's uncertainty as noise of the measurement.
    pub second_order: bool,
    /// The number of magnetometers in each of `measured_nt`.
    pub(super) counts: Vec<f64>,
    /// The fate of measurements that no filter gets; empty where it gets all.
    pub(super) left_out: Vec<Option<Update>>,
    /// The noise that was found.
    pub(super) tuned: Option<Tuned>,
}

/// A magnetometer of a line.
#[derive(Clone)]
pub struct Magnetometer<'a> {
    /// Its column.
    pub name: &'a str,
    /// As [`Flown::measured_nt`].
    pub measured_nt: Vec<f64>,
}

/// The flight table that a filter is planned on.
#[derive(Clone, Copy)]
pub struct Flight<'a> {
    /// Its columns.
    pub shape: &'a Shape,
    /// The magnetometers under `mag`.
    pub mags: &'a [String],
    /// Whether a vector magnetometer tells the direction of the field ([`Flown::field_nt`]).
    pub has_direction: bool,
    /// Whether the measurement holds the core field.
    pub core_field: bool,
    /// How the map is interpolated.
    pub interpolation: Interpolation,
}

impl Flown<'_> {
    /// The line as the filters of the numerics take it.
    ///
    /// # Errors
    /// Without a map.
    pub fn line(&self) -> Result<NavigationLine<'_>, Fault> {
        Ok(NavigationLine {
            ins: &self.ins,
            measurement_nt: &self.measured_nt,
            sigma_nt: &self.sigma_nt,
            map: self.needed_map()?,
            core: self.core.as_ref(),
            errors: self.errors,
            offset_window_s: self.offset_window_s,
            fixes: None,
            second_order: self.second_order,
        })
    }

    /// [`Flown::line`] with a discretisation of the process noise.
    ///
    /// # Errors
    /// Without a map.
    pub fn line_with(&self, noise: NoiseDiscretisation) -> Result<NavigationLine<'_>, Fault> {
        Ok(NavigationLine { errors: InsErrorModel { noise, ..self.errors }, ..self.line()? })
    }

    /// One sigma of the white noise of one magnetometer at each sample, in nT, for a filter that takes each of
    /// [`Flown::magnetometers`]. The map's error is the same in all: each has the more of it the more there are.
    pub fn sigma_of_each_nt(&self) -> Vec<f64> {
        let count = self.magnetometers.len() as f64;
        (0..self.ins.len()).map(|row| self.own_sigma_nt(row).hypot(count.sqrt() * self.map_sigma_at(row))).collect()
    }

    /// What a sensor adds.
    pub(super) fn own_sigma_nt(&self, row: usize) -> f64 {
        let sensor_nt = self.measurement_sigma_nt * self.noise_factors.as_ref().map_or(1.0, |factors| factors[row]);
        self.sample_sigma_nt.as_ref().map_or(sensor_nt, |sigma_nt| sensor_nt.hypot(sigma_nt[row]))
    }

    /// What the map adds.
    pub(super) fn map_sigma_at(&self, row: usize) -> f64 {
        self.map_sigma_nt.as_ref().map_or(0.0, |sigma_nt| sigma_nt[row])
    }

    /// Whether the noise was found from the measurements of the line.
    pub fn is_tuned(&self) -> bool {
        self.tuned.is_some()
    }

    /// The positions by GNSS that passed their test.
    pub fn fixes(&self) -> Option<&PositionFixes> {
        self.gnss.as_ref().map(|gnss| &gnss.accepted)
    }

    /// The map.
    ///
    /// # Errors
    /// Without one.
    pub fn needed_map(&self) -> Result<&FieldMap, Fault> {
        self.map.ok_or_else(|| Fault::bug("a filter without a map needs one"))
    }
}

choice! {
    /// What became of a measurement.
    pub enum Update {
        /// The filter used it.
        Used = "used",
        /// There was none.
        Missing = "missing",
        /// The predicted position is off the map or in an unknown cell.
        OffMap = "off_map",
        /// Its innovation was too large.
        Gated = "gated",
        /// The map is too flat there to tell a position; the temporal variation was corrected.
        Flat = "flat",
        /// The filter had no use for it.
        Unused = "unused",
    }
}

/// The estimate of a filter, one value a sample: the state after the measurement of the sample.
#[derive(Clone, Debug, Default)]
pub struct Track {
    /// Latitude, in degrees of WGS-84.
    pub lat_deg: Vec<f64>,
    /// Longitude, in degrees.
    pub lon_deg: Vec<f64>,
    /// Height above the ellipsoid, in m.
    pub alt_m: Vec<f64>,
    /// Velocity north, in m/s.
    pub vn_mps: Vec<f64>,
    /// Velocity east, in m/s.
    pub ve_mps: Vec<f64>,
    /// Velocity down, in m/s.
    pub vd_mps: Vec<f64>,
    /// One sigma of the position north, in m.
    pub sd_n_m: Vec<f64>,
    /// One sigma of the position east, in m.
    pub sd_e_m: Vec<f64>,
    /// Covariance of the position errors north and east, in m².
    pub cov_ne_m2: Vec<f64>,
    /// Innovation, in nT; NaN where there was none.
    pub residual_nt: Vec<f64>,
    /// The innovation squared over its variance; NaN with it.
    pub nis: Vec<f64>,
    /// What became of the measurement.
    pub update: Vec<Update>,
    /// The arrays of [`NavigationFilter::columns`].
    pub more: Vec<ArrayRef>,
}

impl Track {
    /// The track of a filter's output, whose states are left to the filter. `gate_nis` is its innovation gate.
    ///
    /// # Errors
    /// When not a single measurement was used, or the offset is unknown.
    pub fn of(flown: &Flown, out: NavigationOutput, gate_nis: Option<f64>) -> Result<Track, Fault> {
        enough(flown, &out.report)?;
        Ok(Self::with_any(flown, out, gate_nis))
    }

    /// The same, where a line without a single measurement to use has a track too.
    pub fn with_any(flown: &Flown, out: NavigationOutput, gate_nis: Option<f64>) -> Track {
        let update = |(residual, (nis, measured)): (&f64, (&f64, &f64))| match gate_nis {
            _ if !measured.is_finite() => Update::Missing,
            _ if residual.is_nan() => Update::OffMap,
            Some(gate) if *nis > gate => Update::Gated,
            Some(_) | None => Update::Used,
        };
        let update = out.residual_nt.iter().zip(out.nis.iter().zip(&flown.measured_nt)).map(update).collect();
        Track { update, ..Track::without_updates(out) }
    }

    /// The track of a filter's output that does not say what became of the measurements.
    pub fn without_updates(out: NavigationOutput) -> Track {
        Track {
            lat_deg: out.lat_deg,
            lon_deg: out.lon_deg,
            alt_m: out.alt_m,
            vn_mps: out.vn_mps,
            ve_mps: out.ve_mps,
            vd_mps: out.vd_mps,
            sd_n_m: out.sd_n_m,
            sd_e_m: out.sd_e_m,
            cov_ne_m2: out.cov_ne_m2,
            residual_nt: out.residual_nt,
            nis: out.nis,
            update: vec![],
            more: vec![],
        }
    }
}

/// Refuses a line of which no measurement could be used.
pub(super) fn enough(flown: &Flown, report: &NavigationReport) -> Result<(), Fault> {
    if report.updates == 0 {
        let what = format!(
            "no sample could be used: {} without a measurement, {} off the map",
            report.missing_measurements, report.off_map
        );
        return Err(Fault::data(what).help("does the map cover the flight?"));
    }
    if flown.offset_window_s > 0.0 && report.offset_samples == 0 {
        return Err(Fault::data(
            "no sample within `offset_window_s` has a measurement and a map value, so the offset is unknown",
        ));
    }
    Ok(())
}

/// The states, in the order of thesis 000 (5.14).
const STATE_NAMES: [&str; STATES] = [
    "lat", "lon", "alt", "vn", "ve", "vd", "tilt_n", "tilt_e", "tilt_d", "acc_1", "acc_2", "acc_3", "gyro_1", "gyro_2",
    "gyro_3", "ha", "a_hat", "s",
];

/// The columns of `save_state`: the states `x` and their covariance `p`.
pub fn state_columns() -> Vec<Column> {
    let states: Vec<String> = STATE_NAMES.map(str::to_owned).to_vec();
    let pairs = STATE_NAMES.iter().flat_map(|a| STATE_NAMES.iter().map(move |b| format!("{a}*{b}"))).collect();
    vec![
        Column::list("x", "", "error state, truth - INS, thesis 000 (5.14); rad, m, s, nT", states),
        Column::list("p", "", "covariance of x, row-major", pairs),
    ]
}

/// The arrays of [`state_columns`], taken out of a filter's output.
///
/// # Errors
/// When they cannot be made a list column.
pub fn state_arrays(out: &mut NavigationOutput) -> Result<Vec<ArrayRef>, Fault> {
    // The filter's own memory: a long flight's covariances take half a gigabyte.
    let (x, p) = (std::mem::take(&mut out.x), std::mem::take(&mut out.p));
    Ok(vec![list(x.into_flattened(), STATES)?, list(p.into_flattened().into_flattened(), STATES * STATES)?])
}

/// A filter with the keys that it was given.
pub trait NavigationFilter: Any + Send + Sync {
    /// What it hands out beside the track.
    fn columns(&self, _flight: &Flight) -> Vec<Column> {
        vec![]
    }

    /// The columns that it reads beside the INS and `mag`.
    ///
    /// # Errors
    /// When the flight lacks one, or has it in another unit.
    fn reads(&self, _flight: &Flight) -> Result<Vec<String>, Vec<Fault>> {
        Ok(vec![])
    }

    /// Its keys of the positions that aid it, where it takes any: [`Flown::fixes`].
    fn aiding(&self) -> Option<&Aiding> {
        None
    }

    /// Whether it has a gate of its own.
    fn gates(&self) -> bool {
        false
    }

    /// How much work a sample is, in any unit of its own: see `Stage::effort` of the crate `schemas`.
    fn effort(&self) -> f64 {
        1.0
    }

    /// Whether it takes each magnetometer by itself; else it is handed their mean.
    fn each_magnetometer(&self) -> bool {
        false
    }

    /// Whether it has a use for the measured field.
    fn takes_field(&self) -> bool {
        true
    }

    /// Whether it cannot do without a map.
    fn needs_map(&self) -> bool {
        true
    }

    /// Whether it has a use for a map.
    fn takes_map(&self) -> bool {
        self.needs_map()
    }

    /// Whether it has a use for calibrations, the tables of `fit`.
    fn takes_models(&self) -> bool {
        false
    }

    /// Whether it needs the direction of the field in the sensor, `vector`.
    fn takes_direction(&self) -> bool {
        false
    }

    /// Why one of its own keys has no say beside the others; `None` where it has.
    fn idle(&self, _key: &str) -> Option<Fault> {
        None
    }

    /// Filters one line.
    ///
    /// # Errors
    /// When the line cannot be filtered; the other lines go on.
    fn navigate(&self, flown: &Flown) -> Result<Track, Fault>;

    /// Filters one line by several points of a sweep, which all have the same INS: one answer a point, in their order,
    /// with the bits of [`NavigationFilter::navigate`].
    ///
    /// # Errors
    /// Each answer fails as [`NavigationFilter::navigate`].
    fn navigate_points(points: &[(&Self, &Flown)]) -> Vec<Result<Track, Fault>>
    where
        Self: Sized,
    {
        points.iter().map(|(filter, flown)| filter.navigate(flown)).collect()
    }
}

/// A filter whose type is forgotten, with a line.
pub type Point<'a> = (&'a dyn NavigationFilter, &'a Flown<'a>);

/// A filter as it declares itself.
#[derive(Debug)]
pub struct Filter {
    /// The word after `filter =`.
    pub name: &'static str,
    /// Raised whenever its answer changes.
    pub version: u32,
    /// What it estimates and how, when you want it, source: the lines of its documentation.
    pub doc: &'static [&'static str],
    /// Keys, one a line, for the example of the stage with this filter.
    pub example: &'static str,
    /// Its own keys.
    pub docs: fn() -> Vec<ParamDoc>,
    /// Reads its own keys.
    pub read: fn(&mut Reader) -> Option<Own<dyn NavigationFilter>>,
    /// See [`NavigationFilter::navigate_points`]; all are filters of this type.
    pub navigate_points: fn(&[Point]) -> Vec<Result<Track, Fault>>,
}

impl Filter {
    /// What the reference says of it.
    pub(super) fn document(&self) -> KindDoc {
        let (doc, params) = (collect_doc(self.doc), (self.docs)());
        KindDoc { key: "filter", name: self.name, doc, facts: vec![], params, example: self.example }
    }
}

impl Kind for Filter {
    type Keys = dyn NavigationFilter;
    const DEFAULT: Option<&'static str> = Some("ekf");

    fn name(&self) -> &'static str {
        self.name
    }

    fn version(&self) -> u32 {
        self.version
    }

    fn docs(&self) -> Vec<ParamDoc> {
        (self.docs)()
    }

    fn read(&self, reader: &mut Reader) -> Option<Own<dyn NavigationFilter>> {
        (self.read)(reader)
    }
}

/// [`NavigationFilter::navigate_points`] of the filters of type `F` among `points`.
///
/// # Errors
/// Each answer fails as [`NavigationFilter::navigate`].
#[doc(hidden)]
pub fn navigate_points<F: NavigationFilter>(points: &[Point]) -> Vec<Result<Track, Fault>> {
    let mut ours: Vec<Option<(&F, &Flown)>> = vec![];
    for (filter, flown) in points {
        // Of a list of one kind all have its type.
        let filter: &dyn Any = *filter;
        ours.push(filter.downcast_ref::<F>().map(|filter| (filter, *flown)));
    }
    let typed: Vec<(&F, &Flown)> = ours.iter().flatten().copied().collect();
    let mut answers = F::navigate_points(&typed).into_iter();
    let answer = |point: Option<(&F, &Flown)>| {
        point.and_then(|_| answers.next()).unwrap_or_else(|| Err(Fault::bug("a point of a filter was lost")))
    };
    ours.into_iter().map(answer).collect()
}

/// Declares a navigation filter: its documentation, name and version, keys for an example, and its own keys as in
/// [`params!`](schemas::params!).
///
/// ```
/// use schemas::{Fault, Rule};
/// use stages::navigate::{Flown, NavigationFilter, Track, Update, filter};
/// filter! {
///     /// The INS, moved north.
///     Shifted = "shifted", version 1, example "north_m = 10.0";
///     /// How far.
///     north_m: f64, unit "m", default 0.0, rule Rule::Finite;
/// }
/// impl NavigationFilter for Shifted {
///     fn navigate(&self, flown: &Flown) -> Result<Track, Fault> {
///         let ins = &flown.ins;
///         let lat_deg = ins.lat_deg.iter().map(|lat| lat + self.north_m / 111_200.0).collect();
///         let none = vec![f64::NAN; ins.len()];
///         Ok(Track {
///             lat_deg,
///             lon_deg: ins.lon_deg.to_vec(),
///             alt_m: ins.alt_m.to_vec(),
///             vn_mps: ins.vn_mps.to_vec(),
///             ve_mps: ins.ve_mps.to_vec(),
///             vd_mps: ins.vd_mps.to_vec(),
///             sd_n_m: none.clone(),
///             sd_e_m: none.clone(),
///             cov_ne_m2: none.clone(),
///             residual_nt: none.clone(),
///             nis: none,
///             update: vec![Update::Missing; ins.len()],
///             more: vec![],
///         })
///     }
/// }
/// assert_eq!(Shifted::FILTER.name, "shifted");
/// ```
#[macro_export]
macro_rules! filter {
    (
        $(#[doc = $d:literal])*
        $Ty:ident = $name:literal, version $v:literal, $(groups [$($g:ident : $gt:ty),* $(,)?],)? example $example:literal;
        $($keys:tt)*
    ) => {
        schemas::params! {
            $(#[doc = $d])*
            pub struct $Ty $(, groups [$($g: $gt),*])?;
            $($keys)*
        }

        impl $Ty {
            /// The declaration.
            pub const FILTER: $crate::navigate::Filter = $crate::navigate::Filter {
                name: $name,
                version: $v,
                doc: &[$($d),*],
                example: $example,
                docs: || <$Ty as schemas::Params>::docs(&schemas::Lists::default()),
                read: |reader| schemas::Own::of::<$Ty>(reader, |filter| std::sync::Arc::new(filter)),
                navigate_points: $crate::navigate::navigate_points::<$Ty>,
            };
        }
    };
}
pub use filter;
