//! Filters fed sample by sample, for a flight computer: `ekf`, `ekf_adaptive` and `ekf_online_tl`.
//!
//! A [`FilterStream`] and the filter of a whole line ([`ekf`](crate::navigation::ekf),
//! [`adaptive`](crate::navigation::adaptive), [`online`](crate::navigation::online)) run the same recursion. On the
//! same samples their results are bit-identical.
//!
//! # Samples
//!
//! | Sample | Result |
//! |:--|:--|
//! | later than the last one by at most [`StreamSetup::max_gap_s`] | one step of this length, and the measurements |
//! | later by more | [`StreamError::Gap`]; the INS between the samples is unknown |
//! | at the time of the last one (duplicate) | [`StreamError::Duplicate`] |
//! | before the last one (late) | [`StreamError::Late`] |
//! | an INS value that is not finite, or a latitude at a pole | [`StreamError::NotFinite`], [`StreamError::Latitude`] |
//! | a number of measurements, sigmas or terms that differs from the filter's | [`StreamError::Count`] |
//! | a measurement that is NaN, or whose sigma is not above 0 | counts as missing; the step is made |
//! | a term that is not finite | the magnetometer counts as missing |
//! | a position off the map | no measurement of the field is used |
//!
//! These errors leave the filter unchanged. The caller can drop the sample and continue with the next one. Only
//! [`StreamError::Diverged`] and [`StreamError::Refused`] stop the filter; every later sample then returns
//! [`StreamError::Stopped`]. A stopped filter must be replaced.
//!
//! # Restrictions
//!
//! - An offset window ([`StreamSetup::offset_window_s`]) averages measurements that follow the first sample. The
//!   constructor rejects it. Subtract a known offset from each measurement; the online filter can estimate a constant.
//! - The bias of a vector magnetometer ([`online::Fluxgate`](crate::navigation::online::Fluxgate)) and the further
//!   measurements of [`aids`](crate::navigation::aids) are not available in a stream.
//! - The terms of a whole line use central differences, which need the next sample. A caller that computes terms in
//!   flight must delay its samples by one sample, or use one-sided differences with other coefficients.
//!
//! # Cost
//!
//! A sample takes as long as in the filter of a whole line: 2.5 µs for `ekf` and `ekf_adaptive`, 4.5 µs for
//! `ekf_online_tl` with 18 terms, on one core. Memory is allocated by the constructors, [`FilterStream::save`],
//! [`FilterStream::restore`] and `clone`, and by the first sample after them. All other samples allocate nothing.
//!
//! # Example
//!
//! An INS at rest, 40 m south of its computed position, over a map with a slope of 0.05 nT/m. The filter is saved after
//! ten samples, and another filter resumes from the bytes.
//!
//! ```
//! use std::sync::Arc;
//!
//! use numerics::earth::EarthModel;
//! use numerics::maps::{FieldMap, GeographicGrid, MapInterpolation, MapSurface};
//! use numerics::navigation::stream::{FilterStream, InsSample, StreamError, StreamSample, StreamSetup};
//!
//! let (lat_deg, lon_deg) = ([44.9, 45.0, 45.1], [-76.1, -76.0, -75.9]);
//! let m_per_deg = EarthModel::Wgs84.north_m_per_rad(45_f64.to_radians(), 300.0) / 1_f64.to_degrees();
//! let nodes_nt = lat_deg.map(|lat| [0.05 * m_per_deg * (lat - 45.0); 3]);
//! let grid = GeographicGrid::new(&lat_deg, &lon_deg, nodes_nt.as_flattened())?;
//! let map = Arc::new(FieldMap::Flat(MapSurface::new(&grid, MapInterpolation::Linear)));
//!
//! let mut setup = StreamSetup::new(map);
//! setup.errors.sources.init_position_sigma_m = 100.0;
//! setup.errors.fogm_sigma_nt = 0.0;
//! let mut filter = FilterStream::ekf(&setup, Some(10.83))?;
//! let sample = |k: u32| InsSample {
//!     tt_s: 0.1 * f64::from(k),
//!     lat_deg: 45.0,
//!     lon_deg: -76.0,
//!     alt_m: 300.0,
//!     force_ned_mps2: [0.0, 0.0, -9.80665],
//!     ..InsSample::default()
//! };
//! let field = StreamSample { measurement_nt: &[-2.0], sigma_nt: &[1.0], ..StreamSample::default() };
//! let measured = |k| StreamSample { ins: sample(k), ..field };
//! for k in 0..10 {
//!     filter.push(&measured(k))?;
//! }
//! let mut resumed = FilterStream::ekf(&setup, Some(10.83))?;
//! resumed.restore(&filter.save())?;
//! let (one, other) = (filter.push(&measured(10))?, resumed.push(&measured(10))?);
//! assert_eq!(one, other);
//! assert!(((one.lat_deg - 45.0) * m_per_deg + 40.0).abs() < 2.0, "{}", (one.lat_deg - 45.0) * m_per_deg);
//! assert!(one.sd_n_m < 10.0);
//!
//! // A sample that arrives twice is an error, and the filter is unchanged.
//! assert!(matches!(filter.push(&measured(10)), Err(StreamError::Duplicate { .. })));
//! assert_eq!(filter.push(&measured(11))?, resumed.push(&measured(11))?);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod sample;
mod state;

use std::sync::Arc;

use crate::earth::core_field::CoreField;
use crate::maps::map_stack::FieldMap;
use crate::navigation::adaptive::{AdaptiveParameters, StreamedAdaptive};
use crate::navigation::ekf::{EkfParameters, StreamedEkf};
use crate::navigation::field::PredictedField;
use crate::navigation::ins_error::{InsErrorModel, ParameterError};
use crate::navigation::ins_series::InsSeries;
use crate::navigation::online::{OnlineParameters, StreamedOnline};
use crate::navigation::output::{NavigationError, NavigationOutput, NavigationReport};
use crate::navigation::pinson::{StateMatrix, StateVector};
use crate::navigation::position_fixes::NO_FIX;
use params::Fault;

pub use crate::navigation::online::StreamMagnetometer;
pub use crate::navigation::position_fixes::PositionFix;
pub use sample::{InsSample, MagnetometerEstimate, StreamError, StreamEstimate, StreamSample};
pub(crate) use sample::{SampleInput, StreamedFilter};
pub use state::StateError;
pub(crate) use state::StateVisitor;
use state::{StateReader, StateWriter, fnv1a};

/// Map, core field and error model of a stream.
#[derive(Clone, Debug)]
pub struct StreamSetup {
    /// Map.
    pub map: Arc<FieldMap>,
    /// Core field, if and only if the measurements contain it. Default: none.
    pub core: Option<Arc<CoreField>>,
    /// Error sources of the INS and the temporal variation.
    pub errors: InsErrorModel,
    /// Adds the variance from the curvature of the map over the position uncertainty to the measurement noise.
    /// Default: false.
    pub second_order: bool,
    /// Offset window of the filter of a whole line, in seconds. It must be 0, the default.
    pub offset_window_s: f64,
    /// Longest permitted step between two samples, in seconds; infinity permits any step. Default: 10 s.
    pub max_gap_s: f64,
}

impl StreamSetup {
    /// Set-up with this map and the default of every other field.
    pub fn new(map: Arc<FieldMap>) -> Self {
        let errors = InsErrorModel::default();
        Self { map, core: None, errors, second_order: false, offset_window_s: 0.0, max_gap_s: 10.0 }
    }

    fn check(&self) -> Result<(), ParameterError> {
        self.errors.check()?;
        if self.offset_window_s != 0.0 {
            let what = "`offset_window_s` averages samples that a stream does not have yet: set it to 0, and \
                        subtract a known offset from each measurement";
            return Err(ParameterError(Fault::new(what).of_param("offset_window_s")));
        }
        if self.max_gap_s.is_nan() || self.max_gap_s <= 0.0 {
            let what = format!("`max_gap_s` must be above 0, not {}", self.max_gap_s);
            return Err(ParameterError(Fault::new(what).of_param("max_gap_s")));
        }
        Ok(())
    }

    fn field(&self) -> PredictedField<'static> {
        PredictedField::shared(self.map.clone(), self.core.as_ref()).with_second_order(self.second_order)
    }
}

/// Recursion of a stream.
#[derive(Clone)]
enum StreamKind {
    Ekf(Box<StreamedEkf>),
    Adaptive(Box<StreamedAdaptive>),
    Online(Box<StreamedOnline>),
}

impl StreamKind {
    fn filter(&self) -> &dyn StreamedFilter {
        match self {
            Self::Ekf(filter) => &**filter,
            Self::Adaptive(filter) => &**filter,
            Self::Online(filter) => &**filter,
        }
    }

    fn filter_mut(&mut self) -> &mut dyn StreamedFilter {
        match self {
            Self::Ekf(filter) => &mut **filter,
            Self::Adaptive(filter) => &mut **filter,
            Self::Online(filter) => &mut **filter,
        }
    }

    /// Number that identifies the kind of filter in a saved state.
    fn number(&self) -> u32 {
        match self {
            Self::Ekf(_) => 1,
            Self::Adaptive(_) => 2,
            Self::Online(_) => 3,
        }
    }
}

/// Filter that takes one sample at a time.
#[derive(Clone)]
pub struct FilterStream {
    kind: StreamKind,
    setup: StreamSetup,
    /// Hash of all parameters.
    fingerprint: u64,
    magnetometers: usize,
    /// Number of terms of all magnetometers.
    terms: usize,
    /// INS columns of the last two samples.
    window: [[f64; 2]; 13],
    samples: usize,
    is_stopped: bool,
}

impl FilterStream {
    /// Extended Kalman filter of the compensated field of one magnetometer. A measurement whose NIS is above `gate_nis`
    /// is rejected and counted; `None` uses every measurement.
    ///
    /// # Errors
    /// Fails for an invalid error model, an offset window other than 0, or a gap or gate that is not above 0.
    pub fn ekf(setup: &StreamSetup, gate_nis: Option<f64>) -> Result<Self, ParameterError> {
        setup.check()?;
        let (errors, second_order) = (setup.errors, setup.second_order);
        let keep = EkfParameters { keep_states: true, keep_covariance: true, ..EkfParameters::default() };
        let parameters = EkfParameters { errors, gate_nis, second_order, ..keep };
        parameters.check()?;
        let kind = StreamKind::Ekf(Box::new(StreamedEkf::new(parameters, setup.field())));
        Ok(Self::new(kind, setup, &format!("{gate_nis:?}"), [1, 0]))
    }

    /// Extended Kalman filter that estimates the noise of the magnetometers from the innovations. Each element of
    /// `bounds_nt` defines a magnetometer by the lower and upper bound of its standard deviation, in nT. The keys
    /// `keep_states` and `keep_covariance` have no effect.
    ///
    /// # Errors
    /// Returns the errors of [`FilterStream::ekf`] and [`AdaptiveParameters::check`]. Also fails without a
    /// magnetometer, or for bounds that are not finite numbers above 0 in ascending order.
    pub fn adaptive(
        setup: &StreamSetup,
        parameters: &AdaptiveParameters,
        bounds_nt: &[[f64; 2]],
    ) -> Result<Self, ParameterError> {
        setup.check()?;
        if bounds_nt.is_empty() {
            return Err(ParameterError(Fault::new("no magnetometer is given").of_param("mags")));
        }
        let filter = StreamedAdaptive::new(parameters, bounds_nt, setup.errors, setup.field())?;
        let of = format!("{parameters:?} {bounds_nt:?}");
        Ok(Self::new(StreamKind::Adaptive(Box::new(filter)), setup, &of, [bounds_nt.len(), 0]))
    }

    /// Extended Kalman filter of uncompensated magnetometers that estimates their coefficients in flight. The keys that
    /// begin with `keep_` have no effect.
    ///
    /// # Errors
    /// Returns the errors of [`FilterStream::ekf`]. Also fails without a magnetometer, or for invalid priors and
    /// densities.
    pub fn online(
        setup: &StreamSetup,
        magnetometers: &[StreamMagnetometer<'_>],
        parameters: &OnlineParameters,
    ) -> Result<Self, ParameterError> {
        setup.check()?;
        let (map, model) = (setup.map.clone(), (setup.errors, setup.second_order));
        let filter = StreamedOnline::new(map, setup.field(), model, magnetometers, parameters)?;
        let terms = magnetometers.iter().map(|magnetometer| magnetometer.prior.mean.len()).sum();
        let of = format!("{:?} {:?} {magnetometers:?}", parameters.gate_nis, parameters.recover_after);
        Ok(Self::new(StreamKind::Online(Box::new(filter)), setup, &of, [magnetometers.len(), terms]))
    }

    fn new(kind: StreamKind, setup: &StreamSetup, parameters: &str, [magnetometers, terms]: [usize; 2]) -> Self {
        let StreamSetup { core, errors, second_order, .. } = setup;
        let all = format!("{parameters} {errors:?} {second_order} {}", core.is_some());
        Self {
            kind,
            setup: setup.clone(),
            fingerprint: fnv1a(all.as_bytes()),
            magnetometers,
            terms,
            window: [[0.0; 2]; 13],
            samples: 0,
            is_stopped: false,
        }
    }

    /// Filters a sample and returns the estimate after its measurements.
    ///
    /// # Errors
    /// Fails in the cases that the [table of samples](self#samples) lists.
    pub fn push(&mut self, sample: &StreamSample<'_>) -> Result<StreamEstimate, StreamError> {
        if self.is_stopped {
            return Err(StreamError::Stopped);
        }
        self.check(sample)?;
        for (pair, value) in self.window.iter_mut().zip(sample.ins.values()) {
            *pair = [pair[1], value];
        }
        let row = usize::from(self.samples > 0);
        let ins = InsSeries::from_columns(self.window.each_ref().map(|pair| &pair[1 - row..]));
        let fixes = sample.fix.map_or(NO_FIX, |fix| fix.of(&ins, row, self.setup.errors.earth));
        let StreamSample { measurement_nt, sigma_nt, terms, .. } = *sample;
        let input = SampleInput { measurement_nt, sigma_nt, terms, fixes };
        let filter = self.kind.filter_mut();
        filter.clear();
        if let Err(fault) = filter.sample(&ins, row, &input) {
            self.is_stopped = true;
            return Err(match fault {
                NavigationError::Diverged { tt_s, .. } => StreamError::Diverged { tt_s },
                other => StreamError::Refused(other),
            });
        }
        self.samples += 1;
        self.estimate().ok_or(StreamError::Stopped)
    }

    fn check(&self, sample: &StreamSample<'_>) -> Result<(), StreamError> {
        let count = |what: &'static str, found: usize, expected: usize| match found == expected {
            true => Ok(()),
            false => Err(StreamError::Count { what, found, expected }),
        };
        count("measurements", sample.measurement_nt.len(), self.magnetometers)?;
        count("standard deviations", sample.sigma_nt.len(), self.magnetometers)?;
        count("terms", sample.terms.len(), self.terms)?;
        sample.ins.check()?;
        if let Some(fix) = &sample.fix {
            fix.check().map_err(StreamError::Fix)?;
        }
        if self.samples == 0 {
            return Ok(());
        }
        let (tt_s, last_s, max_gap_s) = (sample.ins.tt_s, self.window[0][1], self.setup.max_gap_s);
        match tt_s - last_s {
            step_s if step_s < 0.0 => Err(StreamError::Late { tt_s, last_s }),
            0.0 => Err(StreamError::Duplicate { tt_s }),
            step_s if step_s > max_gap_s => Err(StreamError::Gap { tt_s, last_s, max_gap_s }),
            _ => Ok(()),
        }
    }

    fn output(&self) -> &NavigationOutput {
        self.kind.filter().output()
    }

    /// Estimate after the last sample; `None` before the first one and directly after [`FilterStream::restore`].
    pub fn estimate(&self) -> Option<StreamEstimate> {
        StreamEstimate::from_output(self.output(), self.window[0][1])
    }

    /// Error states after the last sample, in the order of [`pinson`](crate::navigation::pinson); `None` if
    /// [`FilterStream::estimate`] is `None`.
    pub fn states(&self) -> Option<&StateVector> {
        self.output().x.first()
    }

    /// Covariance of the error states after the last sample; `None` if [`FilterStream::estimate`] is `None`.
    pub fn covariance(&self) -> Option<&StateMatrix> {
        self.output().p.first()
    }

    /// Quantities of a magnetometer at the last sample; `None` for `ekf`, for an invalid index, and if
    /// [`FilterStream::estimate`] is `None`.
    pub fn magnetometer(&self, place: usize) -> Option<MagnetometerEstimate> {
        self.kind.filter().magnetometer(place)
    }

    /// Coefficients of all magnetometers after the last sample, and their standard deviations; empty if the filter does
    /// not estimate coefficients or if [`FilterStream::estimate`] is `None`.
    pub fn coefficients(&self) -> (&[f64], &[f64]) {
        self.kind.filter().coefficients()
    }

    /// Report on the use of the samples so far.
    pub fn report(&self) -> NavigationReport {
        self.output().report
    }

    /// State as bytes: the last sample, the filter's numbers to the last bit, and the counts of the report. The bytes
    /// contain neither parameters nor map, which the caller passes to the constructor again.
    pub fn save(&self) -> Vec<u8> {
        let mut writer = StateWriter::new(self.kind.number(), self.fingerprint);
        self.clone().visit(&mut writer);
        writer.finish()
    }

    /// Resumes from a state of [`FilterStream::save`]. The result of the next sample is then bit-identical to that
    /// without an interruption.
    ///
    /// # Errors
    /// Fails for bytes that are damaged or have another version, for another filter or other parameters, or for another
    /// map or core field, which is recognised by the field at the last position. The filter is then unchanged.
    pub fn restore(&mut self, bytes: &[u8]) -> Result<(), StateError> {
        let mut reader = StateReader::new(bytes, self.kind.number(), self.fingerprint)?;
        let mut resumed = self.clone();
        resumed.kind.filter_mut().clear();
        let saved_nt = resumed.visit(&mut reader);
        reader.finish()?;
        let found_nt = resumed.field_nt();
        if saved_nt.to_bits() != found_nt.to_bits() {
            return Err(StateError::Field { saved_nt, found_nt });
        }
        *self = resumed;
        Ok(())
    }

    /// Visits the whole state. Returns the field at the last position, in nT. If the visitor reads a saved state, this
    /// is the stored field.
    fn visit(&mut self, state: &mut dyn StateVisitor) -> f64 {
        let mut field_nt = self.field_nt();
        self.window.iter_mut().for_each(|pair| state.numbers(pair));
        state.number(&mut field_nt);
        state.count(&mut self.samples, usize::MAX);
        let mut is_stopped = usize::from(self.is_stopped);
        state.count(&mut is_stopped, 1);
        self.is_stopped = is_stopped == 1;
        self.kind.filter_mut().visit(state);
        field_nt
    }

    /// Field at the last position of the INS, in nT; NaN off the map.
    fn field_nt(&self) -> f64 {
        let [lat_deg, lon_deg, alt_m] = [1, 2, 3].map(|column: usize| self.window[column][1]);
        let core = self.setup.core.as_ref().map_or(0.0, |core| core.magnitude_nt(lat_deg, lon_deg, alt_m));
        self.setup.map.at(lat_deg, lon_deg, alt_m).map_or(f64::NAN, |field| field.value_nt + core)
    }
}
