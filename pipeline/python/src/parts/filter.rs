//! A filter of `navigate`, written in Python.

use std::{any::Any, sync::Arc};

use numerics::{
    earth::{core_field::CoreField, geodesy::EarthModel},
    maps::map_stack::FieldMap,
    navigation::PredictedField,
};
use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::{
    exceptions::{PyKeyError, PyValueError},
    prelude::*,
    types::PyDict,
};
use schemas::{ChoiceKeys, Fault, Literal, ParamReader, ParamValue};
use serde::Deserialize;
use stages::{
    fit::KeyDocsFn,
    navigate::{FilterDecl, FilterGroups, FilterInput, FilterTrack, NavigationFilter, UpdateOutcome, navigate_points},
};

use super::{
    PartDecl, PartHead,
    call::{broken, in_python},
    params::PartValues,
};

/// Declaration of a filter.
#[derive(Debug, Deserialize)]
pub struct PythonFilterDecl {
    #[serde(flatten)]
    head: PartDecl,
    needs_map: bool,
}

/// A registered filter.
pub struct FilterPart {
    pub head: &'static PartHead,
    pub decl: &'static FilterDecl,
}

impl FilterPart {
    /// The filter of a declaration. `run` is called with a flight and the parameters.
    ///
    /// # Errors
    /// Fails if a default is invalid.
    pub fn new(decl: PythonFilterDecl, run: Py<PyAny>) -> Result<FilterPart, String> {
        let head: &'static PartHead = Box::leak(Box::new(PartHead::new(decl.head, run)?));
        let (name, needs_map) = (head.name, decl.needs_map);
        let docs: &'static KeyDocsFn = Box::leak(Box::new(move || head.documents()));
        let read = Box::leak(Box::new(move |reader: &mut ParamReader| read_keys(head, needs_map, reader)));
        let doc = Box::leak(Box::new([head.doc]));
        let (version, source) = (head.version, Some(head.source));
        let navigate_points = navigate_points::<PythonFilter>;
        let made = FilterDecl { name, version, source, doc, example: "", docs, read, navigate_points };
        Ok(FilterPart { head, decl: Box::leak(Box::new(made)) })
    }
}

fn read_keys(
    part: &'static PartHead,
    needs_map: bool,
    reader: &mut ParamReader,
) -> Option<ChoiceKeys<dyn NavigationFilter>> {
    let values = PartValues::read(&part.params, reader)?;
    let mut spelt = vec![];
    values.spell(&mut spelt);
    Some(ChoiceKeys { keys: Arc::new(PythonFilter { part, needs_map, values }), spelt })
}

/// A filter with its parameters.
pub struct PythonFilter {
    part: &'static PartHead,
    needs_map: bool,
    values: PartValues,
}

impl FilterGroups for PythonFilter {
    fn groups(&self) -> Vec<&dyn Any> {
        vec![]
    }
}

impl NavigationFilter for PythonFilter {
    fn needs_map(&self) -> bool {
        self.needs_map
    }

    /// The method of a filter in Python is unknown, so the error of its initial position is not checked.
    fn takes_wide_start(&self) -> bool {
        true
    }

    fn navigate(&self, input: &FilterInput) -> Result<FilterTrack, Fault> {
        let name = self.part.name;
        let flight = Flight::new(name, input)?;
        let rows = input.ins.len();
        let found = in_python(name, |py| {
            let made = self.part.run.bind(py).call1((flight, self.values.arguments(py)?))?;
            let made = made.cast_into::<PyDict>()?;
            let column = |key: &str| -> PyResult<Option<Vec<f64>>> {
                let Some(values) = made.get_item(key)? else { return Ok(None) };
                let values: PyReadonlyArray1<'_, f64> = values.extract()?;
                let values = values.as_slice()?.to_vec();
                let what = || PyValueError::new_err(format!("`{key}` has {} values for {rows} samples", values.len()));
                if values.len() == rows { Ok(Some(values)) } else { Err(what()) }
            };
            let mut columns = vec![];
            for key in COLUMNS {
                columns.push(column(key)?);
            }
            let update = made.get_item("update")?.map(|words| words.extract::<Vec<String>>()).transpose()?;
            Ok((columns, update))
        })?;
        track(name, input, found)
    }
}

/// Columns of a track, in the order of [`FilterTrack`]. The first two are required.
const COLUMNS: [&str; 11] = ["lat", "lon", "alt", "vn", "ve", "vd", "sd_n", "sd_e", "cov_ne", "residual", "nis"];

type Found = (Vec<Option<Vec<f64>>>, Option<Vec<String>>);

/// The track of the returned columns. If height or velocity is not returned, it is taken from the INS; other missing
/// columns are NaN.
fn track(name: &str, input: &FilterInput, (columns, update): Found) -> Result<FilterTrack, Fault> {
    let (ins, rows) = (&input.ins, input.ins.len());
    let mut columns = columns.into_iter();
    let mut next = || columns.next().flatten();
    let missing = |key: &str| broken(name, &format!("did not return `{key}`"));
    let (lat_deg, lon_deg) = (next().ok_or_else(|| missing("lat"))?, next().ok_or_else(|| missing("lon"))?);
    let of_ins = [ins.alt_m, ins.vn_mps, ins.ve_mps, ins.vd_mps];
    let [alt_m, vn_mps, ve_mps, vd_mps] = of_ins.map(|values| next().unwrap_or_else(|| values.to_vec()));
    let [sd_n_m, sd_e_m, cov_ne_m2, residual_nt, nis] = [(); 5].map(|()| next().unwrap_or(vec![f64::NAN; rows]));
    let update = match update {
        Some(words) if words.len() != rows => {
            return Err(broken(name, &format!("returned {} values of `update` for {rows} samples", words.len())));
        }
        Some(words) => {
            let read = |word: String| {
                let known = UpdateOutcome::read(&Literal::Text(word.clone()));
                known.ok_or_else(|| Fault {
                    help: None,
                    ..broken(name, &format!("returned the unknown outcome `{word}`"))
                })
            };
            words.into_iter().map(read).collect::<Result<Vec<_>, Fault>>()?
        }
        None => {
            let outcome =
                |residual: &f64| if residual.is_finite() { UpdateOutcome::Used } else { UpdateOutcome::Missing };
            residual_nt.iter().map(outcome).collect()
        }
    };
    let more = vec![];
    Ok(FilterTrack {
        lat_deg,
        lon_deg,
        alt_m,
        vn_mps,
        ve_mps,
        vd_mps,
        sd_n_m,
        sd_e_m,
        cov_ne_m2,
        residual_nt,
        nis,
        update,
        more,
    })
}

/// Names of the columns of a flight: the columns of the INS, then the measurement and its standard deviation, in nT.
const FLIGHT: [&str; 15] =
    ["tt", "lat", "lon", "alt", "vn", "ve", "vd", "fn", "fe", "fd", "roll", "pitch", "yaw", "measured", "sigma"];

/// Field, in nT, and its slopes north, east and up, in nT/m.
type FieldColumns<'py> = [Bound<'py, PyArray1<f64>>; 4];

/// One line for a navigation filter. ``flight["lat"]`` and the other columns of the INS have the units of the flight
/// table. ``flight["measured"]`` is the scalar field, nT (NaN: missing), and ``flight["sigma"]`` its standard
/// deviation.
#[pyclass(frozen, module = "magline", name = "Flight")]
pub struct Flight {
    columns: Vec<Vec<f64>>,
    map: Option<FieldMap>,
    core: Option<Arc<CoreField>>,
}

impl Flight {
    fn new(name: &str, input: &FilterInput) -> Result<Flight, Fault> {
        let ins = &input.ins;
        let mut measured = input.measured_nt.clone();
        if let Some(map) = input.map.filter(|_| input.offset_window_s > 0.0) {
            let mut field = PredictedField::new(map, input.core.as_ref());
            let (offset_nt, samples) = field.offset(ins, &measured, input.offset_window_s);
            if samples == 0 {
                let what = "no sample within `offset_window_s` has both a measurement and a map value";
                return Err(Fault::data(format!("{what}; the filter `{name}` requires such a sample")));
            }
            measured.iter_mut().for_each(|m| *m -= offset_nt);
        }
        let ins = [
            ins.tt_s,
            ins.lat_deg,
            ins.lon_deg,
            ins.alt_m,
            ins.vn_mps,
            ins.ve_mps,
            ins.vd_mps,
            ins.fn_mps2,
            ins.fe_mps2,
            ins.fd_mps2,
            ins.roll_deg,
            ins.pitch_deg,
            ins.yaw_deg,
        ];
        let mut columns: Vec<Vec<f64>> = ins.into_iter().map(<[f64]>::to_vec).collect();
        columns.extend([measured, input.sigma_nt.clone()]);
        Ok(Flight { columns, map: input.map.cloned(), core: input.core.clone() })
    }
}

#[pymethods]
impl Flight {
    /// Number of samples.
    fn __len__(&self) -> usize {
        self.columns.first().map_or(0, Vec::len)
    }

    /// Names of the columns.
    #[getter]
    fn columns(&self) -> Vec<&'static str> {
        FLIGHT.to_vec()
    }

    fn __getitem__<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let at = FLIGHT.iter().position(|known| *known == name);
        let values = at.and_then(|at| self.columns.get(at));
        let known = FLIGHT.join(", ");
        let unknown = || PyKeyError::new_err(format!("a flight has no column `{name}` (known here: {known})"));
        Ok(PyArray1::from_slice(py, values.ok_or_else(unknown)?))
    }

    /// Expected measurement at positions (deg, deg, m), in nT, and its slopes north, east and up, in nT/m: the map,
    /// plus the core field if the measurement contains it. NaN off the map.
    fn field<'py>(
        &self,
        py: Python<'py>,
        lat: PyReadonlyArray1<'py, f64>,
        lon: PyReadonlyArray1<'py, f64>,
        alt: PyReadonlyArray1<'py, f64>,
    ) -> PyResult<FieldColumns<'py>> {
        let (lat, lon, alt) = (lat.as_slice()?, lon.as_slice()?, alt.as_slice()?);
        if lat.len() != lon.len() || lat.len() != alt.len() {
            return Err(PyValueError::new_err("`lat`, `lon` and `alt` must have equal lengths"));
        }
        let none = || PyValueError::new_err("the stage has no map; declare the filter with needs_map=True");
        let map = self.map.as_ref().ok_or_else(none)?;
        let found = py.detach(|| {
            let (mut field, earth) = (PredictedField::new(map, self.core.as_ref()), EarthModel::default());
            let mut found = [(); 4].map(|()| Vec::with_capacity(lat.len()));
            for ((&lat, &lon), &alt) in lat.iter().zip(lon).zip(alt) {
                let (north, east) = earth.north_east_m_per_rad(lat.to_radians(), alt);
                let values = field.at(lat, lon, alt).map_or([f64::NAN; 4], |at| {
                    [at.value_nt, at.d_lat_nt_per_rad / north, at.d_lon_nt_per_rad / east, at.d_alt_nt_per_m]
                });
                found.iter_mut().zip(values).for_each(|(column, value)| column.push(value));
            }
            found
        });
        Ok(found.map(|column| PyArray1::from_vec(py, column)))
    }
}
