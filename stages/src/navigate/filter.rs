//! Interface of a navigation filter: declaration, inputs and outputs.
//!
//! A filter is one file with its declaration by [`filter!`](crate::filter!), its run and its tests, and one line in
//! [`FILTERS`](super::FILTERS).

mod input;
mod track;

use std::{any::Any, fmt};

use schemas::{ChoiceDoc, ChoiceKeys, ChoiceKind, Column, Fault, ParamDoc, ParamReader, collect_doc};

use super::{aiding::Aiding, aircraft::AircraftModelKeys, further::AuxiliaryMeasurements};
use crate::fit::KeyDocsFn;

pub(super) use input::PermanentStates;
pub use input::{FilterFlight, FilterInput, FilterMagnetometer};
pub(super) use track::enough;
pub use track::{FilterTrack, UpdateOutcome, state_arrays, state_columns};

/// Groups of keys that a filter shares with other filters. Implemented by [`filter!`](crate::filter!).
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
    /// Fails if the flight lacks a column or has it in another unit.
    fn reads(&self, _flight: &FilterFlight) -> Result<Vec<String>, Vec<Fault>> {
        Ok(vec![])
    }

    /// Keys of the aiding positions ([`FilterInput::fixes`]), if the filter uses such positions.
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

    /// Whether the filter requires at least one table of `fit`.
    fn needs_model(&self) -> bool {
        false
    }

    /// Keys of the aircraft field whose coefficients are states of the filter, and, if set, the random walk of each
    /// coefficient in one hour as a fraction of its prior standard deviation.
    fn aircraft(&self) -> Option<(&AircraftModelKeys, Option<f64>)> {
        None
    }

    /// Whether the filter can have states of the scalar measurement: a change of the aircraft's permanent field
    /// ([`FilterInput::permanent`]), a lag of the magnetometer ([`FilterInput::latency_sigma_s`]) and a height bias
    /// ([`FilterInput::map_height_sigma_m`]).
    fn takes_scalar_states(&self) -> bool {
        false
    }

    /// Whether the filter accepts an initial position error larger than the distance over which the map is linear.
    /// Other filters with a map linearise it from the first sample on; their tables have the columns
    /// [`START_COLUMNS`](super::START_COLUMNS).
    fn takes_wide_start(&self) -> bool {
        false
    }

    /// Whether the filter requires `vector`, the direction of the field in the frame of the sensor.
    fn takes_direction(&self) -> bool {
        self.further().is_some_and(AuxiliaryMeasurements::takes_direction)
    }

    /// Fault of a key that has no effect with the other keys; `None` if the key has an effect.
    fn unused_key(&self, _key: &str) -> Option<Fault> {
        None
    }

    /// Filters one line.
    ///
    /// # Errors
    /// Fails if the line cannot be filtered. The other lines are not affected.
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

/// A type-erased filter with the line that it filters.
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

/// Calls [`NavigationFilter::navigate_points`] for the filters of type `F` among `points`.
///
/// # Errors
/// Each result fails in the cases of [`NavigationFilter::navigate`].
#[doc(hidden)]
pub fn navigate_points<F: NavigationFilter>(points: &[FilterPoint]) -> Vec<Result<FilterTrack, Fault>> {
    let mut ours: Vec<Option<(&F, &FilterInput)>> = vec![];
    for (filter, flown) in points {
        // All filters of one kind have the same type, so the cast succeeds for every point.
        let filter: &dyn Any = *filter;
        ours.push(filter.downcast_ref::<F>().map(|filter| (filter, *flown)));
    }
    let typed: Vec<(&F, &FilterInput)> = ours.iter().flatten().copied().collect();
    let mut answers = F::navigate_points(&typed).into_iter();
    let answer = |point: Option<(&F, &FilterInput)>| {
        point
            .and_then(|_| answers.next())
            .unwrap_or_else(|| Err(Fault::bug("the result of a filter at a point is missing")))
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
        $Ty:ident = $name:literal, version $v:literal,
        $(groups [$($g:ident : $gt:ty),* $(,)?],)? example $example:literal;
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
