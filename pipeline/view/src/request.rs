//! Requests of the page, from the path and the query of an address.

use report::view::{GeographicRegion, MapBand, SeriesRequest, ViewPoint};
use schemas::Fault;
use url::form_urlencoded;

/// Maximum length of a name in a request, in bytes.
const LONGEST: usize = 1000;

/// Request that a worker answers.
#[derive(Clone, Debug)]
pub enum ViewRequest {
    /// The tables of scores and the last runs, which the page shows.
    Sections,
    /// The list of all tables.
    Catalogue,
    /// Lines of a table at a sweep point.
    Lines(String, ViewPoint),
    /// Series of a line.
    Series(SeriesRequest),
    /// Scores of a table.
    Scores(String),
    /// Scores of a table in an earlier run, compared with another run; by default, the other run is the newest.
    Against(String, String, Option<String>),
    /// Progress of a run, or the list of runs.
    Run,
    /// Map at a sweep point, with its maximum width and the values to show.
    Map(String, ViewPoint, Option<usize>, MapBand),
    /// Values of a map at a sweep point, along a line between two positions (latitude and longitude in degrees).
    Profile(String, ViewPoint, [(f64, f64); 2]),
    /// Spectra of columns of a line.
    Spectrum(SeriesRequest),
    /// Coastlines of a region.
    Coast(GeographicRegion),
    /// Lineage of a table.
    Lineage(String),
    /// Training losses of a model at a sweep point.
    Training(String, ViewPoint),
    /// Importance of the inputs of a model at a sweep point.
    Importance(String, ViewPoint),
    /// Sources and tables of a pipeline with their parameters.
    Parameters(String),
    /// Table to download, and the file format.
    Download(String, DownloadFormat),
}

/// File format of a download.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DownloadFormat {
    /// CSV.
    Csv,
    /// Parquet.
    Parquet,
}

impl DownloadFormat {
    /// The extension of files in this format.
    pub fn extension(self) -> &'static str {
        match self {
            DownloadFormat::Csv => "csv",
            DownloadFormat::Parquet => "parquet",
        }
    }

    /// The media type.
    pub fn media_type(self) -> &'static str {
        match self {
            DownloadFormat::Csv => "text/csv; charset=utf-8",
            DownloadFormat::Parquet => "application/vnd.apache.parquet",
        }
    }
}

/// The parts of a query string.
#[derive(Debug, Default)]
pub struct ViewQuery(Vec<(String, String)>);

impl ViewQuery {
    /// Reads a query string.
    ///
    /// # Errors
    /// Fails for a string that is too long.
    pub fn read(query: &str) -> Result<ViewQuery, Fault> {
        let pairs: Vec<(String, String)> = form_urlencoded::parse(query.as_bytes()).into_owned().collect();
        if pairs.iter().any(|(key, value)| key != "columns" && key.len().max(value.len()) > LONGEST) {
            return Err(Fault::new(format!("a name or value in the request is longer than {LONGEST} bytes")));
        }
        Ok(ViewQuery(pairs))
    }

    fn find(&self, key: &str) -> Option<&str> {
        self.0.iter().find(|(k, _)| k == key).map(|(_, v)| v.as_str())
    }

    fn need(&self, key: &str) -> Result<String, Fault> {
        let missing =
            || Fault::new(format!("the request has no `{key}`")).help(format!("add `{key}=…` to the address"));
        self.find(key).filter(|value| !value.is_empty()).map(str::to_owned).ok_or_else(missing)
    }

    fn number<T: std::str::FromStr>(&self, key: &str) -> Result<Option<T>, Fault> {
        let wrong = |text: &str| Fault::new(format!("`{key}={text}` is not a number"));
        self.find(key).filter(|v| !v.is_empty()).map(|text| text.parse().map_err(|_| wrong(text))).transpose()
    }

    fn time(&self, key: &str) -> Result<Option<f64>, Fault> {
        match self.number::<f64>(key)? {
            Some(time) if !time.is_finite() => Err(Fault::new(format!("`{key}={time}` is not a time in seconds"))),
            time => Ok(time),
        }
    }

    fn degrees(&self, key: &str) -> Result<f64, Fault> {
        self.need(key)?;
        let found = self.number::<f64>(key)?.filter(|v| v.is_finite());
        found.ok_or_else(|| Fault::new(format!("`{key}` is not an angle in degrees")))
    }

    /// Latitude and longitude, in degrees.
    fn position(&self, key: &str) -> Result<(f64, f64), Fault> {
        let text = self.need(key)?;
        let pair = text.split_once(',').and_then(|(lat, lon)| Some((lat.parse().ok()?, lon.parse().ok()?)));
        let wrong = || Fault::new(format!("`{key}={text}` is not a position")).help("write it as LAT,LON in degrees");
        pair.filter(|(lat, lon): &(f64, f64)| lat.is_finite() && lon.is_finite()).ok_or_else(wrong)
    }

    fn point(&self) -> ViewPoint {
        let axis = |(key, value): &(String, String)| Some((key.strip_prefix("axis.")?.to_owned(), value.clone()));
        self.0.iter().filter_map(axis).collect()
    }

    fn band(&self) -> Result<MapBand, Fault> {
        let Some(name) = self.find("band") else { return Ok(MapBand::default()) };
        let fault = || Fault::new(format!("there is no band `{name}`")).help("use `anomaly` or `error`");
        MapBand::from_name(name).ok_or_else(fault)
    }

    fn series(&self) -> Result<SeriesRequest, Fault> {
        let listed = self.0.iter().filter(|(k, _)| k == "columns").flat_map(|(_, v)| v.split(','));
        let single = self.0.iter().filter(|(k, _)| k == "column").map(|(_, v)| v.as_str());
        let columns: Vec<String> = listed.chain(single).filter(|c| !c.is_empty()).map(str::to_owned).collect();
        Ok(SeriesRequest {
            table: self.need("table")?,
            flight: self.need("flight")?,
            line: self.need("line")?,
            columns,
            point: self.point(),
            from: self.time("from")?,
            to: self.time("to")?,
            pixels: self.number("pixels")?,
        })
    }

    /// The request below `api/`; `None` for an unknown address.
    ///
    /// # Errors
    /// Fails for missing and wrong values.
    pub fn request(&self, name: &str) -> Result<Option<ViewRequest>, Fault> {
        Ok(Some(match name {
            "sections" => ViewRequest::Sections,
            "catalogue" => ViewRequest::Catalogue,
            "lines" => ViewRequest::Lines(self.need("table")?, self.point()),
            "series" => ViewRequest::Series(self.series()?),
            "scores" => ViewRequest::Scores(self.need("table")?),
            "against" => {
                let run = self.find("run").filter(|run| !run.is_empty()).map(str::to_owned);
                ViewRequest::Against(self.need("table")?, self.need("against")?, run)
            }
            "run" => ViewRequest::Run,
            "map" => ViewRequest::Map(self.need("table")?, self.point(), self.number("pixels")?, self.band()?),
            "profile" => {
                let ends = [self.position("from")?, self.position("to")?];
                ViewRequest::Profile(self.need("table")?, self.point(), ends)
            }
            "spectrum" => ViewRequest::Spectrum(self.series()?),
            "coast" => ViewRequest::Coast(GeographicRegion {
                west: self.degrees("west")?,
                east: self.degrees("east")?,
                south: self.degrees("south")?,
                north: self.degrees("north")?,
            }),
            "training" => ViewRequest::Training(self.need("table")?, self.point()),
            "importance" => ViewRequest::Importance(self.need("table")?, self.point()),
            "parameters" => ViewRequest::Parameters(self.need("pipeline")?),
            "lineage" => ViewRequest::Lineage(self.need("table")?),
            _ => return Ok(None),
        }))
    }

    /// Table and format of a download.
    ///
    /// # Errors
    /// Fails for a missing table and an unknown format.
    pub fn download(&self) -> Result<(String, DownloadFormat), Fault> {
        let format = match self.find("format").unwrap_or("csv") {
            "csv" => DownloadFormat::Csv,
            "parquet" => DownloadFormat::Parquet,
            other => return Err(Fault::new(format!("there is no format `{other}`")).help("use `csv` or `parquet`")),
        };
        Ok((self.need("table")?, format))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn unit_names_are_decoded_and_limited() {
        let text =
            "table=a.b&flight=1%200&line=%3Cb%3E%E2%80%AE&columns=x,y&column=p%2Cq&axis.mag=%00&from=1e3&pixels=7";
        let query = ViewQuery::read(text).unwrap();
        let Some(ViewRequest::Series(series)) = query.request("series").unwrap() else { panic!("{query:?}") };
        assert_eq!((series.flight.as_str(), series.line.as_str()), ("1 0", "<b>\u{202e}"));
        assert_eq!(
            (series.columns, series.point),
            (vec!["x".into(), "y".into(), "p,q".into()], vec![("mag".into(), "\0".into())])
        );
        assert_eq!((series.from, series.to, series.pixels), (Some(1000.0), None, Some(7)));
        assert!(ViewQuery::read(&format!("table={}", "x".repeat(1001))).is_err());
        for wrong in ["from=nan", "from=inf", "pixels=-1", "pixels=1e9", "to=x"] {
            let query = ViewQuery::read(&format!("table=a.b&flight=1&line=1&columns=x&{wrong}")).unwrap();
            assert!(query.request("series").is_err(), "{wrong}");
        }
        for (path, wrong) in [
            ("profile", "table=a.b&from=1,2"),
            ("profile", "table=a.b&from=1,2&to=1;2"),
            ("profile", "table=a.b&from=1,2&to=nan,2"),
            ("coast", "west=1&east=2&south=3"),
            ("coast", "west=1&east=2&south=3&north=inf"),
            ("against", "table=a.b"),
            ("map", "table=a.b&band=none"),
            ("map", "table=a.b&band="),
        ] {
            assert!(ViewQuery::read(wrong).unwrap().request(path).is_err(), "{path}?{wrong}");
        }
        let query = ViewQuery::read("table=a.b&from=-1.5,2&to=3,-4&axis.x=1").unwrap();
        let found = query.request("profile").unwrap();
        assert!(matches!(found, Some(ViewRequest::Profile(_, _, [(-1.5, 2.0), (3.0, -4.0)]))), "{found:?}");
        let found = ViewQuery::read("table=a.b&band=error").unwrap().request("map").unwrap();
        assert!(matches!(found, Some(ViewRequest::Map(_, _, None, MapBand::Error))), "{found:?}");
        assert!(ViewQuery::read("").unwrap().request("series").is_err());
        assert!(ViewQuery::read("").unwrap().request("../run").unwrap().is_none());
    }
}
