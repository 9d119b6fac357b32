//! Likely cause of a warning, from the scores of the same line and the parameters of its navigation.

use arrow_array::{
    Array,
    cast::AsArray,
    types::{Float64Type, Int64Type},
};
use numerics::earth::dates::decimal_year;
use plan::{LineId, PlanGraph, TableRef};
use schemas::Fault;
use stages::{
    navigate::START_COLUMNS,
    score::{map, signal, track},
};
use store::Store;

use super::{WarningKind, limits, navigation, row::LineMetrics};
use crate::text::number;

/// Parameters of a navigation that may explain its errors.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NavigationSettings {
    /// The measurement sigma, in nT; `None` if the parameter is estimated from the data.
    pub sigma_nt: Option<f64>,
    /// Whether the noise was estimated from the likelihood of the innovations.
    pub found: bool,
    /// Length of the window over which a bias is estimated, in seconds.
    pub offset_window_s: f64,
    /// Whether the map is continued to the flight heights.
    pub levels: bool,
    /// The date of the core field in the spec, and the date of the flight.
    pub dates: Option<(f64, f64)>,
    /// Time of the first rejected GNSS position, in seconds from the start of the line.
    pub gnss_rejected_s: Option<f64>,
    /// Lag of the magnetometer and its standard deviation at the last sample, in seconds; `None` if the lag is not a
    /// state.
    pub lag_s: Option<(f64, f64)>,
    /// Bias between the height of the INS and the height on the map, and its standard deviation, at the last sample, in
    /// metres; `None` if the bias is not a state.
    pub height_bias_m: Option<(f64, f64)>,
    /// Standard deviation of the initial position, and the distance over which the map is linear, in metres. `None` for
    /// a filter that does not linearise the map.
    pub start_m: Option<(f64, f64)>,
}

/// Table of a navigation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NavigationSide {
    /// Input.
    Flight,
    /// Output.
    Track,
}

impl NavigationSettings {
    /// Settings of a navigation with the parameters `params` in canonical spelling. `first` returns the first value of
    /// a column. Leaves `gnss_rejected_s`, `lag_s` and `height_bias_m` unset.
    ///
    /// # Errors
    /// Fails if `first` fails.
    pub fn new(
        params: &[(&'static str, String)],
        first: impl Fn(NavigationSide, &str) -> Result<Option<f64>, Fault>,
    ) -> Result<NavigationSettings, Fault> {
        use NavigationSide::{Flight, Track};
        let param = |name: &str| params.iter().find(|(n, _)| *n == name).map(|(_, v)| v.as_str());
        let number = |name: &str| param(name).and_then(|v| v.parse::<f64>().ok());
        // `"auto"` uses the residual of the calibration, which is a column of the input. If the key is unset, that
        // residual is not used.
        let found = |param_name: &str, column: &str| match param(param_name) {
            Some("auto") => first(Flight, column),
            _ => Ok(number(param_name)),
        };
        let likely_nt = first(Track, "noise_sigma")?;
        let sigma_nt = match likely_nt {
            Some(sigma_nt) => Some(sigma_nt),
            None => found("measurement_sigma_nt", "mag_sigma")?,
        };
        let declared_year = number("decimal_year").filter(|_| param("core_field") == Some("true"));
        let flight_year = match declared_year {
            Some(_) => flight_date(first(Flight, "year")?, first(Flight, "doy")?),
            None => None,
        };
        let [start, limit] = START_COLUMNS.map(|column| first(Track, column));
        Ok(NavigationSettings {
            sigma_nt,
            found: likely_nt.is_some(),
            offset_window_s: number("offset_window_s").unwrap_or(0.0),
            levels: param("map_levels_m").is_some_and(|v| v != "none"),
            dates: declared_year.zip(flight_year),
            gnss_rejected_s: None,
            lag_s: None,
            height_bias_m: None,
            start_m: start?.zip(limit?),
        })
    }

    /// Dates of the core field and of the flight, in years, if they differ by more than the limit.
    pub fn wrong_date(&self) -> Option<(f64, f64)> {
        self.dates.filter(|(declared, flight)| (declared - flight).abs() > limits::DATE_A)
    }
}

/// Scores and navigation settings of one line.
pub struct LineFacts<'a> {
    /// Scores.
    pub row: &'a LineMetrics,
    /// Settings of the line's navigation; `None` without a track.
    pub settings: Option<NavigationSettings>,
}

impl<'a> LineFacts<'a> {
    /// Collects the known facts of `line` upstream of the tables `inputs` of a score.
    ///
    /// # Errors
    /// Fails if the store cannot be read.
    pub fn gather(
        graph: &PlanGraph,
        store: &Store,
        inputs: &[TableRef],
        line: LineId,
        row: &'a LineMetrics,
    ) -> Result<LineFacts<'a>, Fault> {
        let Some((t, i)) = navigation(graph.plan, inputs) else { return Ok(LineFacts { row, settings: None }) };
        let it = graph.plan.instance(t, i);
        let track = TableRef::Stage(t, i);
        let read = |side: NavigationSide, name: &str| match (side, it.first_input()) {
            (NavigationSide::Track, _) => value(graph, store, (track, line), name, End::First),
            (NavigationSide::Flight, Some(input)) => value(graph, store, (input, line), name, End::First),
            (NavigationSide::Flight, None) => Ok(None),
        };
        let last = |name: &str| value(graph, store, (track, line), name, End::Last);
        let settings = NavigationSettings {
            gnss_rejected_s: match row.counted(&track::GNSS_REJECTED) {
                Some((count, _)) if count > 0.0 => gnss_rejected_s(graph, store, track, line)?,
                Some(_) | None => None,
            },
            lag_s: constant("mag_latency", last)?,
            height_bias_m: constant("map_height_bias", last)?,
            ..NavigationSettings::new(&it.params(), read)?
        };
        Ok(LineFacts { row, settings: Some(settings) })
    }

    /// Expected error of a map at the wrong height, and the limit of this error, in nT, if the error exceeds the limit.
    pub fn map_height_nt(&self) -> Option<(f64, f64)> {
        let limit_nt = limits::map_height_nt(self.settings.as_ref().and_then(|s| s.sigma_nt));
        self.row
            .get(&map::MAP_HEIGHT_ERROR)
            .filter(|error_nt| *error_nt > limit_nt)
            .map(|error_nt| (error_nt, limit_nt))
    }

    /// Time of the first rejected GNSS position, in seconds from the start of the line.
    pub fn gnss_rejected_s(&self) -> Option<f64> {
        self.settings.as_ref().and_then(|s| s.gnss_rejected_s)
    }

    /// Standard deviation of the initial position, and the distance over which the map is linear, in metres, if their
    /// ratio exceeds its limit.
    pub fn wide_start_m(&self) -> Option<(f64, f64)> {
        let exceeds = |(sigma_m, linear_m): &(f64, f64)| *sigma_m > limits::WIDE_START * linear_m;
        self.settings.as_ref().and_then(|s| s.start_m).filter(exceeds)
    }

    /// Lag of the magnetometer and its standard deviation, in seconds, if the lag exceeds its limits.
    pub fn lag_s(&self) -> Option<(f64, f64)> {
        let exceeds = |(lag_s, sigma_s): &(f64, f64)| lag_s.abs() > limits::lag_s(*sigma_s);
        self.settings.as_ref().and_then(|s| s.lag_s).filter(exceeds)
    }

    /// Bias between the height of the INS and the height on the map, and its standard deviation, in metres, if the bias
    /// exceeds its limits.
    pub fn height_bias_m(&self) -> Option<(f64, f64)> {
        let exceeds = |(bias_m, sigma_m): &(f64, f64)| bias_m.abs() > limits::height_bias_m(*sigma_m);
        self.settings.as_ref().and_then(|s| s.height_bias_m).filter(exceeds)
    }

    fn diverged(&self) -> bool {
        self.row.get(&track::DRMS).zip(self.row.get(&track::INS_DRMS)).is_some_and(|(drms, ins)| drms > ins)
    }

    /// Whether the position is lost or overconfident, or the initial position was too uncertain for this filter.
    /// Constants that were estimated along such a track may be as wrong as its positions.
    fn unreliable(&self) -> bool {
        let overconfident = self.row.get(&track::NEES).is_some_and(|nees| nees > limits::CONSISTENT_NEES);
        self.diverged() || overconfident || self.wide_start_m().is_some()
    }

    /// Likely cause of a warning; `None` if no known fact explains it.
    pub fn cause(&self, kind: WarningKind) -> Option<String> {
        if kind == WarningKind::Retention {
            let cause = "the model was fitted over strong anomalies, or learnt the map from its inputs; on a single \
                         line, the residual may also correlate with the anomaly by chance";
            return Some(cause.to_owned());
        }
        let settings = self.settings.as_ref()?;
        let found = match kind {
            WarningKind::WorseThanIns | WarningKind::NeesHigh | WarningKind::NisHigh => self.too_sure(settings, kind),
            WarningKind::NeesLow | WarningKind::NisLow => self.too_cautious(settings),
            WarningKind::Late | WarningKind::HeightBias if self.unreliable() => vec![
                "the filter lost the position or is overconfident on this line, so this estimate may be wrong, too: \
                 first remove the causes of the other warnings of this line"
                    .to_owned(),
            ],
            WarningKind::Late => self.lag_s().map(|(lag_s, _)| {
                format!(
                    "the logger stamps samples when they arrive, or a low-pass filter delays the signal: set the lag \
                     of this column to {lag_s:.2} in `lag_s` of `resample`, before the calibration; an error of the \
                     initial position has a similar effect, so check `start` first"
                )
            }).into_iter().collect(),
            WarningKind::HeightBias => self.height_bias_m().map(|(bias_m, _)| {
                format!(
                    "the barometer has a constant error (pressure setting, temperature), the geoid height is missing \
                     from the height of the INS or of the map, or the map is at another height: add {bias_m:.0} m to \
                     `ins_alt` with `derive`, or subtract it from `alt_m` of the map"
                )
            }).into_iter().collect(),
            WarningKind::Gnss => {
                vec!["the receiver is jammed, spoofed or faulty, or the errors of the INS exceed those of its grade"
                    .to_owned()]
            }
            WarningKind::OffMap if self.diverged() => vec!["the filter diverged and left the map".to_owned()],
            WarningKind::OffMap => {
                vec!["the map does not cover the line, or has unknown nodes below the line".to_owned()]
            }
            WarningKind::Flat => vec![
                "the noise exceeds `flat_over_m` times the slope of the map, so the position comes mainly from the INS"
                    .to_owned(),
            ],
            WarningKind::MapHeight if settings.levels => {
                vec!["the flight leaves the range of heights in `map_levels_m`".to_owned()]
            }
            WarningKind::NotWhite
            | WarningKind::Gated
            | WarningKind::WideStart
            | WarningKind::MapHeight
            | WarningKind::Retention
            | WarningKind::Fit
            | WarningKind::Map
            | WarningKind::Stage
            | WarningKind::Metric => vec![],
        };
        (!found.is_empty()).then(|| found.join("; "))
    }

    fn too_sure(&self, settings: &NavigationSettings, kind: WarningKind) -> Vec<String> {
        let row = self.row;
        let shown = |x: f64| number(Some(x));
        let sigma = settings.sigma_nt;
        let mut found = vec![];
        if let Some((sigma_m, limit_m)) = self.wide_start_m() {
            found.push(format!(
                "the standard deviation of the initial position is {sigma_m:.0} m, but the map is linear only over \
                 {limit_m:.0} m"
            ));
        }
        // An estimated noise includes the effect of an offset.
        if settings.offset_window_s == 0.0 && !settings.found {
            let large = |bias: &f64| bias.abs() > limits::BIAS_SIGMAS * sigma.unwrap_or(5.0);
            let bias = row.get(&signal::BIAS_ERROR).filter(large);
            found.extend(bias.map(|bias| format!("the measurement has a bias (bias_error {} nT)", shown(bias))));
        }
        if let Some((error, _)) = self.map_height_nt() {
            found.push(format!("the map is at a different height from the flight ({} nT rms)", shown(error)));
        }
        if let Some((declared_year, flight_year)) = settings.wrong_date() {
            found.push(format!("`decimal_year` is {declared_year:.2}, but the date in the flight is {flight_year:.2}"));
        }
        let exceeds = |residual: &f64, sigma: f64| *residual > limits::RESIDUAL_SIGMAS * sigma;
        found.extend(self.assumed_and_residual(settings, exceeds));
        if let Some(share) = row.off_map().filter(|s| *s >= limits::OFF_MAP_CAUSE) {
            // A filter that diverges also leaves the map, so measurements off the map need not be the cause.
            found.push(format!("{:.0} % of the measurements are off the map", 100.0 * share));
        }
        let consistent = || row.get(&track::NEES).is_some_and(|nees| nees <= limits::CONSISTENT_NEES);
        if found.is_empty() && kind == WarningKind::WorseThanIns && consistent() {
            found.push("the filter is consistent, but the map has too little information along this line".to_owned());
        }
        found
    }

    fn too_cautious(&self, settings: &NavigationSettings) -> Vec<String> {
        let exceeds = |residual: &f64, sigma: f64| sigma > limits::RESIDUAL_SIGMAS * residual;
        self.assumed_and_residual(settings, exceeds).into_iter().collect()
    }

    /// The assumed noise and the residual of the compensation as text, if `exceeds` accepts the two values.
    fn assumed_and_residual(
        &self,
        settings: &NavigationSettings,
        exceeds: impl Fn(&f64, f64) -> bool,
    ) -> Option<String> {
        let sigma = settings.sigma_nt.filter(|_| !settings.found)?;
        let residual = self.row.get(&signal::STD_ERROR).filter(|residual| exceeds(residual, sigma))?;
        let [residual, sigma] = [residual, sigma].map(|x| number(Some(x)));
        Some(format!(
            "the residual of compensation is {residual} nT (std_error), but `measurement_sigma_nt` is {sigma} nT"
        ))
    }
}

/// The date at the first sample of the line, as a decimal year, if the flight has the columns of a date.
fn flight_date(year: Option<f64>, doy: Option<f64>) -> Option<f64> {
    year.zip(doy).and_then(|(year, doy)| decimal_year(year as i32, doy as u32, 0.0).ok())
}

/// Time of a track's first rejected GNSS position, in seconds from the start of its line.
fn gnss_rejected_s(graph: &PlanGraph, store: &Store, track: TableRef, line: LineId) -> Result<Option<f64>, Fault> {
    let Ok(key) = graph.object(track, line) else { return Ok(None) };
    if !store.has(key) {
        return Ok(None);
    }
    let batch = store.get(key, &["gnss_update"])?;
    let Some(updates) = batch.column_by_name("gnss_update").and_then(|a| a.as_string_opt::<i32>()) else {
        return Ok(None);
    };
    let Some(row) = updates.iter().position(|update| update == Some("rejected")) else { return Ok(None) };
    let origin = graph.origin(track, "tt");
    let Ok(key) = graph.object(origin.made_by, line) else { return Ok(None) };
    if !store.has(key) {
        return Ok(None);
    }
    let batch = store.get(key, &["tt"])?;
    let tt = batch.column_by_name("tt").and_then(|a| a.as_primitive_opt::<Float64Type>());
    Ok(tt.filter(|tt| row < tt.len()).map(|tt| tt.value(row) - tt.value(0)))
}

/// Estimate of a constant state of a track, and its standard deviation: the last values of the two columns.
fn constant(name: &str, last: impl Fn(&str) -> Result<Option<f64>, Fault>) -> Result<Option<(f64, f64)>, Fault> {
    let estimate = last(name)?;
    let sigma = if estimate.is_some() { last(&format!("{name}_sigma"))? } else { None };
    Ok(estimate.zip(sigma))
}

/// End of a column.
#[derive(Clone, Copy)]
enum End {
    First,
    Last,
}

/// The value at one end of a column of a line; `None` without a value.
fn value(
    graph: &PlanGraph,
    store: &Store,
    (r, line): (TableRef, LineId),
    name: &str,
    end: End,
) -> Result<Option<f64>, Fault> {
    let has = |r: TableRef| match r {
        TableRef::Flights(i) => {
            graph.records.get(i).and_then(|r| r.get(&line)).is_some_and(|l| l.columns.contains_key(name))
        }
        TableRef::Stage(t, i) => graph.plan.instance(t, i).makes(name).is_some(),
        TableRef::Map(_) => false,
    };
    let origin = graph.origin(r, name);
    if !has(origin.made_by) {
        return Ok(None);
    }
    let Ok(key) = graph.object(origin.made_by, line) else { return Ok(None) };
    if !store.has(key) {
        return Ok(None);
    }
    let batch = store.get(key, &[name])?;
    let row = match end {
        End::First => 0,
        End::Last => batch.num_rows().saturating_sub(1),
    };
    let Some(array) = batch.columns().first().filter(|a| a.len() > row && a.is_valid(row)) else { return Ok(None) };
    let float = array.as_primitive_opt::<Float64Type>().map(|a| a.value(row));
    Ok(float.or_else(|| array.as_primitive_opt::<Int64Type>().map(|a| a.value(row) as f64)).filter(|v| v.is_finite()))
}
