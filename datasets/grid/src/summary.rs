//! The summary of a map: its extent, spacing, height, gaps and statistics.

use super::{AnomalyGrid, GridHeight, Registration};
use crate::ReadError;
use numerics::regression::statistics::quantile;

/// A value of a summary.
#[derive(Clone, Debug, PartialEq)]
pub enum SummaryValue {
    /// A number.
    Number(f64),
    /// A word or a name.
    Text(String),
}

/// The result of [`AnomalyGrid::summary`]. Coordinates refer to the outermost nodes.
#[derive(Clone, Debug, PartialEq)]
pub struct MapSummary {
    /// The name of the format; empty for a computed map.
    pub format: String,
    /// The EPSG code of the coordinates.
    pub epsg: u16,
    /// The name of the coordinate system.
    pub system: String,
    /// The unit of the coordinates: `deg`, `m`, `ft`, `us-ft`, or empty for another unit.
    pub unit: &'static str,
    /// The meaning of the file's coordinates.
    pub registration: Registration,
    /// The number of columns and rows.
    pub nodes: (usize, usize),
    /// West and east end, in the unit of the system or in degrees.
    pub x: (f64, f64),
    /// South and north end.
    pub y: (f64, f64),
    /// Spacing along x and y, in the unit of the system or in degrees.
    pub spacing: (f64, f64),
    /// Spacing on the ground in the middle of the map, in metres.
    pub spacing_m: (f64, f64),
    /// Smallest and largest latitude, in degrees; `None` for a map around a pole.
    pub lat_deg: Option<(f64, f64)>,
    /// Smallest and largest longitude, in degrees; beyond 180 for a map across the date line.
    pub lon_deg: Option<(f64, f64)>,
    /// The lowest and the highest height, in metres above the ellipsoid; NaN where unknown.
    pub height_m: (f64, f64),
    /// The unit of the values: `nT`, or for derivatives `nT/m` or `nT/m2`.
    pub value_unit: &'static str,
    /// The number of unknown nodes.
    pub unknown: usize,
    /// Smallest, mean and largest known value, in nT.
    pub min_mean_max_nt: (f64, f64, f64),
    /// Standard deviation of the known values (of the population), in nT.
    pub std_nt: f64,
    /// The percentiles 1, 5, 25, 50, 75, 95 and 99 of the known values, in nT, by linear interpolation between the two
    /// nearest values.
    pub percentiles_nt: [f64; 7],
    /// Mean absolute difference between neighbouring known nodes along x and along y, in nT.
    pub mean_step_nt: (f64, f64),
    /// Notes on the processing of the file's values.
    pub notes: Vec<String>,
}

/// The percentiles of a summary.
pub const PERCENTILES: [f64; 7] = [1.0, 5.0, 25.0, 50.0, 75.0, 95.0, 99.0];

impl AnomalyGrid {
    /// The statistics of the map.
    ///
    /// # Errors
    /// Fails in the cases of [`AnomalyGrid::new`].
    pub fn summary(&self) -> Result<MapSummary, ReadError> {
        self.check()?;
        let mut known: Vec<f64> = self.anomaly_nt.iter().copied().filter(|v| !v.is_nan()).collect();
        let count = known.len() as f64;
        // Sums of values such as 1e308 must not overflow.
        let size = known.iter().fold(0.0_f64, |most, v| most.max(v.abs()));
        let size = if size > 1e100 { size } else { 1.0 };
        let mean = known.iter().map(|v| v / size).sum::<f64>() / count * size;
        let squares = known.iter().map(|v| (v / size - mean / size).powi(2)).sum::<f64>();
        let std_nt = (squares / count).sqrt() * size;
        known.sort_unstable_by(f64::total_cmp);
        let bounds = self.bounds_deg().ok();
        let (x_m, y_m) = self.ground_unit_m();
        Ok(MapSummary {
            format: self.format.to_owned(),
            epsg: self.crs.code(),
            system: self.crs.name().to_owned(),
            unit: self.unit(),
            registration: self.registration,
            nodes: (self.x.len, self.y.len),
            x: (self.x.first, self.x.last()),
            y: (self.y.first, self.y.last()),
            spacing: (self.x.step, self.y.step),
            spacing_m: (self.x.step * x_m, self.y.step * y_m),
            lat_deg: bounds.map(|b| b.0),
            lon_deg: bounds.map(|b| b.1),
            height_m: self.height_range(),
            value_unit: self.value_unit,
            unknown: self.nodes() - known.len(),
            min_mean_max_nt: (quantile(&known, 0.0), mean, quantile(&known, 1.0)),
            std_nt,
            percentiles_nt: PERCENTILES.map(|p| quantile(&known, p / 100.0)),
            mean_step_nt: (self.mean_step(1), self.mean_step(self.x.len)),
            notes: self.notes.clone(),
        })
    }

    fn height_range(&self) -> (f64, f64) {
        match &self.height {
            GridHeight::Level(alt_m) => (*alt_m, *alt_m),
            GridHeight::Cells(cells) => {
                let known = || cells.iter().copied().filter(|a| !a.is_nan());
                (known().reduce(f64::min).unwrap_or(f64::NAN), known().reduce(f64::max).unwrap_or(f64::NAN))
            }
        }
    }

    /// Mean absolute difference between neighbouring nodes. `apart` is the distance of neighbours in the list of
    /// values: 1 along x, the length of a row along y.
    fn mean_step(&self, apart: usize) -> f64 {
        let pairs = self.anomaly_nt.iter().zip(self.anomaly_nt.iter().skip(apart)).enumerate();
        let within = |i: usize| apart != 1 || !(i + 1).is_multiple_of(self.x.len);
        let steps = pairs.filter(|(i, (a, b))| within(*i) && !a.is_nan() && !b.is_nan());
        // The running mean cannot overflow, unlike the sum.
        let mean = |(mean, n): (f64, f64), (_, (a, b)): (usize, (&f64, &f64))| {
            let n = n + 1.0;
            (mean + ((a - b).abs() - mean) / n, n)
        };
        let (mean, count) = steps.fold((0.0, 0.0), mean);
        if count == 0.0 { f64::NAN } else { mean }
    }
}

impl MapSummary {
    /// The summary as names, values and units, in display order; unknown values are omitted.
    pub fn figures(&self) -> Vec<(String, SummaryValue, &'static str)> {
        let (unit, number) = (self.unit, SummaryValue::Number);
        let mut all = vec![
            ("format", SummaryValue::Text(self.format.clone()), ""),
            ("epsg", number(f64::from(self.epsg)), ""),
            ("system", SummaryValue::Text(self.system.clone()), ""),
            ("registration", SummaryValue::Text(self.registration_word().to_owned()), ""),
            ("columns", number(self.nodes.0 as f64), ""),
            ("rows", number(self.nodes.1 as f64), ""),
            ("west", number(self.x.0), unit),
            ("east", number(self.x.1), unit),
            ("south", number(self.y.0), unit),
            ("north", number(self.y.1), unit),
            ("spacing_x", number(self.spacing.0), unit),
            ("spacing_y", number(self.spacing.1), unit),
            ("ground_spacing_x", number(self.spacing_m.0), "m"),
            ("ground_spacing_y", number(self.spacing_m.1), "m"),
        ];
        for (ends, names) in [(self.lat_deg, ["lat_min", "lat_max"]), (self.lon_deg, ["lon_min", "lon_max"])] {
            if let Some((least, most)) = ends {
                all.extend([(names[0], number(least), "deg"), (names[1], number(most), "deg")]);
            }
        }
        if !self.height_m.0.is_nan() {
            all.extend([("height_min", number(self.height_m.0), "m"), ("height_max", number(self.height_m.1), "m")]);
        }
        let nodes = (self.nodes.0 * self.nodes.1) as f64;
        all.extend([
            ("unknown", number(self.unknown as f64), ""),
            ("unknown_share", number(100.0 * self.unknown as f64 / nodes), "%"),
            ("min", number(self.min_mean_max_nt.0), self.value_unit),
            ("mean", number(self.min_mean_max_nt.1), self.value_unit),
            ("max", number(self.min_mean_max_nt.2), self.value_unit),
            ("std", number(self.std_nt), self.value_unit),
            ("mean_step_x", number(self.mean_step_nt.0), self.value_unit),
            ("mean_step_y", number(self.mean_step_nt.1), self.value_unit),
        ]);
        let mut all: Vec<_> = all.into_iter().map(|(name, value, unit)| (name.to_owned(), value, unit)).collect();
        let percentiles = PERCENTILES.iter().zip(self.percentiles_nt);
        all.extend(percentiles.map(|(p, v)| (format!("percentile_{p}"), number(v), self.value_unit)));
        all
    }

    fn registration_word(&self) -> &'static str {
        match self.registration {
            Registration::Node => "node",
            Registration::Pixel => "pixel",
        }
    }
}
