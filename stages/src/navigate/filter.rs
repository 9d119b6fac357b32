//! Interface of a navigation filter: declaration, inputs and outputs.
//!
//! A filter is one file with its declaration by [`filter!`](crate::filter!), its run and its tests, and one line in
//! [`FILTERS`](super::FILTERS).

use std::{any::Any, fmt, sync::Arc};

use arrow_array::{ArrayRef, RecordBatch};
use numerics::{
    earth::core_field::CoreField,
    maps::{map_stack::FieldMap, map_surface::MapInterpolation},
    navigation::{
        aided::PermanentChange,
        ins_error::InsErrorModel,
        ins_series::InsSeries,
        line::NavigationLine,
        output::{NavigationOutput, NavigationReport},
        pinson::STATES,
        position_fixes::PositionFixes,
        transition::NoiseDiscretisation,
    },
    signal::gauss_markov::GaussMarkov,
};
use schemas::{
    ChoiceDoc, ChoiceKeys, ChoiceKind, Column, Fault, ParamDoc, ParamReader, TableShape, choice, collect_doc,
};

use super::{
    CalibrationPrior,
    aiding::{Aiding, GnssPositions},
    further::AuxiliaryMeasurements,
    tuning::LineNoiseEstimate,
};
use crate::{columns::list, fit::KeyDocsFn};

/// One flight line as input of a filter.
pub struct FilterInput<'a> {
    /// INS, one value per sample. Columns that the flight lacks are derived.
    pub ins: InsSeries<'a>,
    /// Measured field in nT at each sample, minus the diurnal variation if `remove_diurnal` is set; NaN if missing. It
    /// contains the core field if and only if `core` is given. With several magnetometers, the value is their mean.
    pub measured_nt: Vec<f64>,
    /// Standard deviation of the white noise of each element of `measured_nt`, nT.
    pub sigma_nt: Vec<f64>,
    /// Each magnetometer, for a filter that processes them separately ([`NavigationFilter::each_magnetometer`]); else
    /// empty.
    pub magnetometers: Vec<FilterMagnetometer<'a>>,
    /// The anomaly map, for a filter that requires it ([`NavigationFilter::needs_map`]).
    pub map: Option<&'a FieldMap>,
    /// The core field at the date of the line.
    pub core: Option<Arc<CoreField>>,
    /// Error sources of the INS, and the slow error of the measurement.
    pub errors: InsErrorModel,
    /// Standard deviation of the white noise of one magnetometer, per sample, in nT.
    pub measurement_sigma_nt: f64,
    /// Length in s, from the first sample, of the window whose mean of measurement minus prediction is subtracted; 0
    /// subtracts nothing.
    pub offset_window_s: f64,
    /// Columns that [`NavigationFilter::reads`] returns, and the INS columns.
    pub columns: &'a RecordBatch,
    /// The calibrations in `model`.
    pub models: &'a [CalibrationPrior],
    /// The vector magnetometer `vector`, nT along nose, right and down.
    pub field_nt: Option<[&'a [f64]; 3]>,
    /// The cosine of the angle between the scalar sensor's axis and that field; NaN if unknown.
    pub cosines: Option<Vec<f64>>,
    /// Factor on the standard deviation of each measurement for the attitude; NaN makes the measurement missing.
    pub noise_factors: Option<Vec<f64>>,
    /// Standard deviation of the additional error of each measurement, in nT; NaN makes the measurement missing.
    pub sample_sigma_nt: Option<Vec<f64>>,
    /// Standard deviation of the map error at each sample, as white noise, in nT.
    pub map_sigma_nt: Option<Vec<f64>>,
    /// GNSS positions after the test, for a filter that uses them ([`NavigationFilter::aiding`]).
    pub gnss: Option<GnssPositions>,
    /// Change of the aircraft's permanent field, for a filter that estimates it
    /// ([`NavigationFilter::takes_permanent`]).
    pub permanent: Option<PermanentStates>,
    /// Whether the curvature of the map over the position's uncertainty counts as measurement noise.
    pub second_order: bool,
    /// Number of magnetometers in each element of `measured_nt`.
    pub(super) counts: Vec<f64>,
    /// Outcome of measurements that are withheld from the filter; empty if there are none.
    pub(super) left_out: Vec<Option<UpdateOutcome>>,
    /// Estimated noise.
    pub(super) tuned: Option<LineNoiseEstimate>,
}

/// Change of the aircraft's permanent field as states of a filter.
#[derive(Clone)]
pub struct PermanentStates {
    /// Unit vector of the core field along nose, right and down at each sample.
    pub direction: Vec<[f64; 3]>,
    /// Standard deviation of each component, in nT, and time constant.
    pub process: GaussMarkov,
}

impl PermanentStates {
    /// Model of the change, as input of the filters in `numerics`.
    pub(super) fn model(&self) -> PermanentChange<'_> {
        PermanentChange { direction: &self.direction, process: self.process }
    }
}

/// A magnetometer of a line.
#[derive(Clone)]
pub struct FilterMagnetometer<'a> {
    /// Column name.
    pub name: &'a str,
    /// See [`FilterInput::measured_nt`].
    pub measured_nt: Vec<f64>,
}

/// The flight table that a filter is planned on.
#[derive(Clone, Copy)]
pub struct FilterFlight<'a> {
    /// Columns of the measurement.
    pub shape: &'a TableShape,
    /// The magnetometers in `mag`.
    pub mags: &'a [String],
    /// Whether a vector magnetometer gives the direction of the field ([`FilterInput::field_nt`]).
    pub has_direction: bool,
    /// Whether the measurement contains the core field.
    pub core_field: bool,
    /// Interpolation of the map.
    pub interpolation: MapInterpolation,
}

impl FilterInput<'_> {
    /// Line as input of the filters in `numerics`.
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

    /// [`FilterInput::line`] with a discretisation of the process noise.
    ///
    /// # Errors
    /// Without a map.
    pub fn line_with(&self, noise: NoiseDiscretisation) -> Result<NavigationLine<'_>, Fault> {
        Ok(NavigationLine { errors: InsErrorModel { noise, ..self.errors }, ..self.line()? })
    }

    /// Standard deviation of the white noise of one magnetometer at each sample, in nT, for a filter that uses each of
    /// [`FilterInput::magnetometers`]. The map error is common to all, so its variance is multiplied by their number.
    pub fn sigma_of_each_nt(&self) -> Vec<f64> {
        let count = self.magnetometers.len() as f64;
        (0..self.ins.len()).map(|row| self.own_sigma_nt(row).hypot(count.sqrt() * self.map_sigma_at(row))).collect()
    }

    /// Noise of the sensor.
    pub(super) fn own_sigma_nt(&self, row: usize) -> f64 {
        let sensor_nt = self.measurement_sigma_nt * self.noise_factors.as_ref().map_or(1.0, |factors| factors[row]);
        self.sample_sigma_nt.as_ref().map_or(sensor_nt, |sigma_nt| sensor_nt.hypot(sigma_nt[row]))
    }

    /// Noise of the map.
    pub(super) fn map_sigma_at(&self, row: usize) -> f64 {
        self.map_sigma_nt.as_ref().map_or(0.0, |sigma_nt| sigma_nt[row])
    }

    /// Whether the noise was estimated from the measurements of the line.
    pub fn is_tuned(&self) -> bool {
        self.tuned.is_some()
    }

    /// GNSS positions that passed the test.
    pub fn fixes(&self) -> Option<&PositionFixes> {
        self.gnss.as_ref().map(|gnss| &gnss.accepted)
    }

    /// The map.
    ///
    /// # Errors
    /// If the input has no map.
    pub fn needed_map(&self) -> Result<&FieldMap, Fault> {
        self.map.ok_or_else(|| Fault::bug("a filter without a map needs one"))
    }
}

choice! {
    /// Outcome of a measurement.
    pub enum UpdateOutcome {
        /// Used by the filter.
        Used = "used",
        /// No measurement.
        Missing = "missing",
        /// Predicted position off the map or in an unknown cell.
        OffMap = "off_map",
        /// Innovation above the gate.
        Gated = "gated",
        /// Map too flat to observe the position; the temporal variation was corrected.
        Flat = "flat",
        /// Not needed by the filter.
        Unused = "unused",
    }
}

/// Estimate of a filter, one value per sample: the state a posteriori.
#[derive(Clone, Debug, Default)]
pub struct FilterTrack {
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
    /// Standard deviation of the position north, in m.
    pub sd_n_m: Vec<f64>,
    /// Standard deviation of the position east, in m.
    pub sd_e_m: Vec<f64>,
    /// Covariance of the position errors north and east, in m².
    pub cov_ne_m2: Vec<f64>,
    /// Innovation, in nT; NaN if no measurement was used.
    pub residual_nt: Vec<f64>,
    /// Normalised innovation squared; NaN if `residual_nt` is NaN.
    pub nis: Vec<f64>,
    /// Outcome of the measurement.
    pub update: Vec<UpdateOutcome>,
    /// Arrays of [`NavigationFilter::columns`].
    pub more: Vec<ArrayRef>,
}

impl FilterTrack {
    /// Track from a filter's output, without the states, which the filter adds. `gate_nis` is its innovation gate.
    ///
    /// # Errors
    /// When no measurement was used, or the offset is unknown.
    pub fn from_output(
        flown: &FilterInput,
        out: NavigationOutput,
        gate_nis: Option<f64>,
    ) -> Result<FilterTrack, Fault> {
        enough(flown, &out.report)?;
        Ok(Self::with_any(flown, out, gate_nis))
    }

    /// [`FilterTrack::from_output`] that also accepts a line without a usable measurement.
    pub fn with_any(flown: &FilterInput, out: NavigationOutput, gate_nis: Option<f64>) -> FilterTrack {
        let update = |(residual, (nis, measured)): (&f64, (&f64, &f64))| match gate_nis {
            _ if !measured.is_finite() => UpdateOutcome::Missing,
            _ if residual.is_nan() => UpdateOutcome::OffMap,
            Some(gate) if *nis > gate => UpdateOutcome::Gated,
            Some(_) | None => UpdateOutcome::Used,
        };
        let update = out.residual_nt.iter().zip(out.nis.iter().zip(&flown.measured_nt)).map(update).collect();
        FilterTrack { update, ..FilterTrack::without_updates(out) }
    }

    /// Track of a filter's output without the outcomes of the measurements.
    pub fn without_updates(out: NavigationOutput) -> FilterTrack {
        FilterTrack {
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

/// Rejects a line without a usable measurement.
pub(super) fn enough(flown: &FilterInput, report: &NavigationReport) -> Result<(), Fault> {
    if report.updates == 0 {
        let what = format!(
            "no sample could be used: {} without a measurement, {} off the map",
            report.missing_measurements, report.off_map
        );
        return Err(Fault::data(what).help("check that the map covers the flight"));
    }
    if flown.offset_window_s > 0.0 && report.offset_samples == 0 {
        return Err(Fault::data(
            "no sample within `offset_window_s` has a measurement and a map value, so the offset is unknown",
        ));
    }
    Ok(())
}

/// States, in the order of Gnadt 2022 (5.14).
const STATE_NAMES: [&str; STATES] = [
    "lat", "lon", "alt", "vn", "ve", "vd", "tilt_n", "tilt_e", "tilt_d", "acc_1", "acc_2", "acc_3", "gyro_1", "gyro_2",
    "gyro_3", "ha", "a_hat", "s",
];

/// The columns of `save_state`: the states `x` and their covariance `p`.
pub fn state_columns() -> Vec<Column> {
    let states: Vec<String> = STATE_NAMES.map(str::to_owned).to_vec();
    let pairs = STATE_NAMES.iter().flat_map(|a| STATE_NAMES.iter().map(move |b| format!("{a}*{b}"))).collect();
    vec![
        Column::list("x", "", "error state, truth minus INS, Gnadt 2022 (5.14); rad, m, s, nT", states),
        Column::list("p", "", "covariance of x, row-major", pairs),
    ]
}

/// Arrays of [`state_columns`], taken from a filter's output.
///
/// # Errors
/// If the values do not make a list column.
pub fn state_arrays(out: &mut NavigationOutput) -> Result<Vec<ArrayRef>, Fault> {
    // Moved out of the filter output, because the covariances of a long flight occupy half a gigabyte.
    let (x, p) = (std::mem::take(&mut out.x), std::mem::take(&mut out.p));
    Ok(vec![list(x.into_flattened(), STATES)?, list(p.into_flattened().into_flattened(), STATES * STATES)?])
}

/// Groups of keys that a filter shares with others. Implemented by [`filter!`](crate::filter!).
pub trait FilterGroups {
    /// Groups, in the order of their declaration.
    fn groups(&self) -> Vec<&dyn Any>;
}

/// A filter with its keys. The columns, inputs and faults of its groups `Aiding` and `AuxiliaryMeasurements` are
/// added to those of the filter.
pub trait NavigationFilter: FilterGroups + Any + Send + Sync {
    /// Columns in addition to the track.
    fn columns(&self, _flight: &FilterFlight) -> Vec<Column> {
        vec![]
    }

    /// Columns that the filter reads in addition to the INS and `mag`.
    ///
    /// # Errors
    /// When the flight lacks a column or has it in another unit.
    fn reads(&self, _flight: &FilterFlight) -> Result<Vec<String>, Vec<Fault>> {
        Ok(vec![])
    }

    /// Keys of the aiding positions, if the filter uses any: [`FilterInput::fixes`].
    fn aiding(&self) -> Option<&Aiding> {
        self.groups().into_iter().find_map(|group| group.downcast_ref())
    }

    /// Keys of the measurements in addition to the scalar field, if the filter uses any.
    fn further(&self) -> Option<&AuxiliaryMeasurements> {
        self.groups().into_iter().find_map(|group| group.downcast_ref())
    }

    /// Whether the filter has an innovation gate.
    fn gates(&self) -> bool {
        false
    }

    /// Computing time per sample in arbitrary units: see `Stage::effort` of the crate `schemas`.
    fn effort(&self) -> f64 {
        1.0
    }

    /// Whether the filter processes each magnetometer separately instead of their mean.
    fn each_magnetometer(&self) -> bool {
        false
    }

    /// Whether the filter uses the measured field.
    fn takes_field(&self) -> bool {
        self.further().is_none_or(|further| further.use_scalar)
    }

    /// Whether the filter requires a map.
    fn needs_map(&self) -> bool {
        true
    }

    /// Whether the filter uses a map.
    fn takes_map(&self) -> bool {
        self.needs_map()
    }

    /// Whether the filter uses calibrations, the tables of `fit`.
    fn takes_models(&self) -> bool {
        false
    }

    /// Whether the filter can have states for a change of the aircraft's permanent field
    /// ([`FilterInput::permanent`]).
    fn takes_permanent(&self) -> bool {
        false
    }

    /// Whether the filter requires the direction of the field in the sensor, `vector`.
    fn takes_direction(&self) -> bool {
        self.further().is_some_and(AuxiliaryMeasurements::takes_direction)
    }

    /// Fault of a key that has no effect with the other keys; `None` if the key has an effect.
    fn idle(&self, _key: &str) -> Option<Fault> {
        None
    }

    /// Filters one line.
    ///
    /// # Errors
    /// When the line cannot be filtered. The other lines are not affected.
    fn navigate(&self, flown: &FilterInput) -> Result<FilterTrack, Fault>;

    /// Filters one line at several points of a sweep that share the INS. Returns one result per point, in order,
    /// bit-identical to [`NavigationFilter::navigate`].
    ///
    /// # Errors
    /// Each result fails in the cases of [`NavigationFilter::navigate`].
    fn navigate_points(points: &[(&Self, &FilterInput)]) -> Vec<Result<FilterTrack, Fault>>
    where
        Self: Sized,
    {
        points.iter().map(|(filter, flown)| filter.navigate(flown)).collect()
    }
}

/// A type-erased filter with a line.
pub type FilterPoint<'a> = (&'a dyn NavigationFilter, &'a FilterInput<'a>);

/// Reader of the keys of a filter.
pub type ReadFilterFn = dyn Fn(&mut ParamReader) -> Option<ChoiceKeys<dyn NavigationFilter>> + Send + Sync;

/// Declaration of a filter.
pub struct FilterDecl {
    /// Value of `filter`.
    pub name: &'static str,
    /// Version, raised whenever the results change.
    pub version: u32,
    /// Hash of the source text of a filter that is loaded at run time. `None` for a compiled filter.
    pub source: Option<&'static str>,
    /// Documentation lines: state and method, use, source.
    pub doc: &'static [&'static str],
    /// Keys for the example of the stage with this filter, one per line.
    pub example: &'static str,
    /// Documentation of the filter's keys.
    pub docs: &'static KeyDocsFn,
    /// Reads the filter's keys.
    pub read: &'static ReadFilterFn,
    /// See [`NavigationFilter::navigate_points`]; all points have a filter of this type.
    pub navigate_points: fn(&[FilterPoint]) -> Vec<Result<FilterTrack, Fault>>,
}

impl fmt::Debug for FilterDecl {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.debug_struct("FilterDecl").field("name", &self.name).field("version", &self.version).finish_non_exhaustive()
    }
}

impl FilterDecl {
    /// Entry of the reference.
    pub(super) fn document(&self) -> ChoiceDoc {
        let (doc, params) = (collect_doc(self.doc), (self.docs)());
        ChoiceDoc { key: "filter", name: self.name, doc, facts: vec![], params, example: self.example }
    }
}

impl ChoiceKind for FilterDecl {
    type Keys = dyn NavigationFilter;
    const DEFAULT: Option<&'static str> = Some("ekf");

    fn name(&self) -> &'static str {
        self.name
    }

    fn version(&self) -> u32 {
        self.version
    }

    fn source(&self) -> Option<&str> {
        self.source
    }

    fn docs(&self) -> Vec<ParamDoc> {
        (self.docs)()
    }

    fn read(&self, reader: &mut ParamReader) -> Option<ChoiceKeys<dyn NavigationFilter>> {
        (self.read)(reader)
    }
}

/// [`NavigationFilter::navigate_points`] of the filters of type `F` among `points`.
///
/// # Errors
/// Each result fails in the cases of [`NavigationFilter::navigate`].
#[doc(hidden)]
pub fn navigate_points<F: NavigationFilter>(points: &[FilterPoint]) -> Vec<Result<FilterTrack, Fault>> {
    let mut ours: Vec<Option<(&F, &FilterInput)>> = vec![];
    for (filter, flown) in points {
        // All filters in a list of one kind have the same type.
        let filter: &dyn Any = *filter;
        ours.push(filter.downcast_ref::<F>().map(|filter| (filter, *flown)));
    }
    let typed: Vec<(&F, &FilterInput)> = ours.iter().flatten().copied().collect();
    let mut answers = F::navigate_points(&typed).into_iter();
    let answer = |point: Option<(&F, &FilterInput)>| {
        point.and_then(|_| answers.next()).unwrap_or_else(|| Err(Fault::bug("a point of a filter was lost")))
    };
    ours.into_iter().map(answer).collect()
}

/// Declares a navigation filter: its documentation, name and version, keys for an example, and its own keys as in
/// [`params!`](schemas::params!).
///
/// ```
/// use schemas::{Fault, Rule};
/// use stages::navigate::{FilterInput, NavigationFilter, FilterTrack, UpdateOutcome, filter};
/// filter! {
///     /// The INS, moved north.
///     Shifted = "shifted", version 1, example "north_m = 10.0";
///     /// Distance north.
///     north_m: f64, unit "m", default 0.0, rule Rule::Finite;
/// }
/// impl NavigationFilter for Shifted {
///     fn navigate(&self, flown: &FilterInput) -> Result<FilterTrack, Fault> {
///         let ins = &flown.ins;
///         let lat_deg = ins.lat_deg.iter().map(|lat| lat + self.north_m / 111_200.0).collect();
///         let none = vec![f64::NAN; ins.len()];
///         Ok(FilterTrack {
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
///             update: vec![UpdateOutcome::Missing; ins.len()],
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

        impl $crate::navigate::FilterGroups for $Ty {
            fn groups(&self) -> Vec<&dyn std::any::Any> {
                vec![$($(&self.$g),*)?]
            }
        }

        impl $Ty {
            /// Declaration of the filter.
            pub const FILTER: $crate::navigate::FilterDecl = $crate::navigate::FilterDecl {
                name: $name,
                version: $v,
                source: None,
                doc: &[$($d),*],
                example: $example,
                docs: &|| <$Ty as schemas::Params>::docs(&schemas::ChoiceRegistry::default()),
                read: &|reader| schemas::ChoiceKeys::read::<$Ty>(reader, |filter| std::sync::Arc::new(filter)),
                navigate_points: $crate::navigate::navigate_points::<$Ty>,
            };
        }
    };
}
pub use filter;
