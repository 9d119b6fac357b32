//! Appends what a map says at every sample.

use arrow_array::RecordBatch;
use numerics::{
    earth::geodesy::EarthModel,
    maps::{map_stack::FieldMap, map_surface::Interpolation},
};
use schemas::{Arrays, Column, Fault, LineIn, LineStage, Stage, Table, Yield, stage};

use crate::{
    columns::{array, faults_of, floats, shape},
    core_field::PositionOf,
    maps::{check_levels, field_map},
};

stage! {
    /// Appends what a map says at every sample: the anomaly `map_anomaly` and its slopes `map_grad_n`, `map_grad_e`,
    /// `map_grad_u` (per metre north, east and up).
    ///
    /// Use it to hold a signal against the map, or to see what a map is worth for navigation before flying on it. A sample
    /// off the map, in a cell with an unknown node or without a position has NaN. A map in eastings and northings is
    /// looked up between its own nodes: the position is projected, and the slopes are brought back.
    ///
    /// The map is taken at its own height, where it has no slope upwards. With `map_levels_m` it is continued to these
    /// heights and interpolated between them, so that climbs and descents are followed; a sample further below or above
    /// the levels than half a step has NaN. Downward continuation amplifies what is short: keep levels at or above the map.
    ///
    /// Source: thesis 000, section 2.3; Blakely 1996, chapter 12.
    MapValue = "map_value", version 2, grain Line, inputs [input: Lines, map: Map],
    example r#"
[[stages]]
name         = "map_value"
stage        = "map_value"
input        = "resample"
map          = "anomaly"
map_levels_m = [300.0, 400.0]
"#;
    /// Where: at the true position (`lat`, `lon`, `alt`) or that of the INS.
    position: PositionOf, unit "", default PositionOf::Truth;
    /// How the map is interpolated: bilinear, or by a natural cubic spline.
    map_interpolation: Interpolation, unit "", default Interpolation::Linear;
    /// The heights above the ellipsoid, ascending, to which the map is continued.
    map_levels_m: Option<Vec<f64>>, unit "m", absent "the map is taken at its own height";
}

impl Stage for MapValue {
    fn yields(&self, inputs: &[&Table]) -> Result<Yield, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let place = self.position.columns();
        let units = ["deg", "deg", "m"];
        let mut faults = faults_of(place.iter().zip(units).map(|(c, unit)| shape.number(c, unit)), "position");
        faults.extend(check_levels(self.map_levels_m.as_ref(), "map_levels_m"));
        if !faults.is_empty() {
            return Err(faults);
        }
        let made =
            |name: &str, unit: &str, doc: &str| Column::float(name, unit, doc).from(0, &place).from(1, &["anomaly"]);
        let columns = vec![
            made("map_anomaly", "nT", "anomaly of the map"),
            made("map_grad_n", "nT/m", "slope of the map, northward"),
            made("map_grad_e", "nT/m", "slope of the map, eastward"),
            made("map_grad_u", "nT/m", "slope of the map, upward"),
        ];
        let map = ["lat", "lon", "alt", "anomaly"].map(str::to_owned).to_vec();
        let place = place.map(str::to_owned).to_vec();
        Ok(Yield { reads: vec![place.clone(), map], ..Yield::append(columns, &place) })
    }
}

impl LineStage for MapValue {
    type Prepared = FieldMap;

    fn run(&self, line: &LineIn, map: &FieldMap) -> Arrays {
        let [lat, lon, alt] = self.position.columns();
        let batch = &line.inputs[0];
        let (lat, lon, alt) = (floats(batch, lat)?, floats(batch, lon)?, floats(batch, alt)?);
        let earth = EarthModel::Wgs84;
        let mut columns = [(); 4].map(|()| Vec::with_capacity(lat.len()));
        for i in 0..lat.len() {
            let row = map.at(lat[i], lon[i], alt[i]).map_or([f64::NAN; 4], |field| {
                let at = lat[i].to_radians();
                [
                    field.value_nt,
                    field.d_lat_nt_per_rad / earth.north_m_per_rad(at, alt[i]),
                    field.d_lon_nt_per_rad / earth.east_m_per_rad(at, alt[i]),
                    field.d_alt_nt_per_m,
                ]
            });
            columns.iter_mut().zip(row).for_each(|(column, x)| column.push(x));
        }
        if columns[0].iter().all(|x| x.is_nan()) {
            return Err(Fault::data("no sample is on the map").help("does the map cover the flight, and its heights?"));
        }
        Ok(columns.map(array).into())
    }

    fn prepare(&self, inputs: &[RecordBatch]) -> Result<FieldMap, Fault> {
        let map = inputs.get(1).ok_or_else(|| Fault::data("the map is missing"))?;
        field_map(map, self.map_interpolation, self.map_levels_m.as_deref())
    }

    fn prepare_key(&self) -> String {
        format!("{} {:?}", self.map_interpolation.word(), self.map_levels_m)
    }
}
