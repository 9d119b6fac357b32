//! What a navigation filter declares of itself, what it is handed and hands back.
//!
//! A filter is one file: its declaration by [`filter!`](crate::filter!), its run, its tests; and one line in [`FILTERS`](super::FILTERS).

use std::{any::Any, sync::Arc};

use arrow_array::ArrayRef;
use numerics::{
    earth::core_field::CoreField,
    maps::map_stack::FieldMap,
    navigation::{ins_error::InsErrorModel, ins_series::InsSeries},
};
use schemas::{Column, Fault, Kind, KindDoc, Own, ParamDoc, Reader, choice, collect_doc};

/// A flight line as every filter is handed it.
pub struct Flown<'a> {
    /// The INS, a value a sample; what the flight lacks is derived.
    pub ins: InsSeries<'a>,
    /// The compensated field in nT at each sample, less the temporal variation where that is known; NaN where there is
    /// none. It holds the core field if, and only if, `core` is given.
    pub measured_nt: Vec<f64>,
    /// The anomaly map.
    pub map: &'a FieldMap,
    /// The core field at the date of the line.
    pub core: Option<Arc<CoreField>>,
    /// The error sources of the INS, and the lasting part of the measurement's error.
    pub errors: InsErrorModel,
    /// The white part of the measurement's error, a sample, in nT.
    pub measurement_sigma_nt: f64,
    /// The length of the window in s, from the first sample, whose mean of measurement minus prediction is taken off;
    /// 0 takes nothing off.
    pub offset_window_s: f64,
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

/// A filter with the keys that it was given.
pub trait NavigationFilter: Any + Send + Sync {
    /// What it hands out beside the track.
    fn columns(&self) -> Vec<Column> {
        vec![]
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
