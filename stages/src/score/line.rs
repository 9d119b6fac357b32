//! The line to score: its columns, and intermediate results shared by several metrics.

use std::cell::OnceCell;

use arrow_array::{StringArray, cast::AsArray};
use numerics::{
    earth::geodesy::EarthModel,
    regression::statistics::{self, SeriesMoments},
};
use schemas::{Fault, LineInput, MagneticCorrection, TableShape};

use super::{
    Score,
    source::{ScoreSource, ScoreSourceColumns, ScoreSourceIndex},
};
use crate::{columns::floats, corrections::had};

/// A value computed on first use.
pub type LazyResult<T> = OnceCell<Result<T, Fault>>;

/// A signal before and after compensation, in nT.
pub struct CompensationSignals {
    /// Before compensation.
    pub before_nt: Vec<f64>,
    /// After compensation.
    pub after_nt: Vec<f64>,
}

/// Offsets of positions from the true positions, in metres.
pub struct HorizontalErrors {
    /// Northward.
    pub north_m: Vec<f64>,
    /// Eastward.
    pub east_m: Vec<f64>,
}

/// One line of the tables to score.
pub struct ScoreLine<'a> {
    /// The parameters.
    pub stage: &'a Score,
    line: &'a LineInput,
    places: &'a ScoreSourceIndex,
    error: LazyResult<SeriesMoments>,
    signals: LazyResult<CompensationSignals>,
    track_error: LazyResult<HorizontalErrors>,
    radii: LazyResult<Vec<f64>>,
    map_error: LazyResult<SeriesMoments>,
}

impl<'a> ScoreLine<'a> {
    /// Columns of `line` at the given `places`.
    pub fn new(stage: &'a Score, line: &'a LineInput, places: &'a ScoreSourceIndex) -> ScoreLine<'a> {
        let (error, signals) = (LazyResult::new(), LazyResult::new());
        let (track_error, radii, map_error) = (LazyResult::new(), LazyResult::new(), LazyResult::new());
        ScoreLine { stage, line, places, error, signals, track_error, radii, map_error }
    }

    /// Times of the samples, in seconds.
    ///
    /// # Errors
    /// Fails if the line has no numeric column `tt`.
    pub fn tt(&self) -> Result<&[f64], Fault> {
        floats(&self.line.inputs[0], "tt")
    }

    /// Columns of a source, in the order that the source defines.
    ///
    /// # Errors
    /// Fails if the line lacks the source, or one of its columns does not hold numbers.
    pub fn columns(&self, source: ScoreSource) -> Result<Vec<&[f64]>, Fault> {
        let ScoreSourceColumns { table, columns } = self.place(source)?;
        columns.iter().map(|name| floats(&self.line.inputs[*table], name)).collect()
    }

    /// Values of a source with a single column.
    ///
    /// # Errors
    /// Fails if the line lacks the source, or its column does not hold numbers.
    pub fn column(&self, source: ScoreSource) -> Result<&[f64], Fault> {
        let place = self.place(source)?;
        let name = place.columns.first().ok_or_else(|| self.without(source))?;
        floats(&self.line.inputs[place.table], name)
    }

    /// Same as [`ScoreLine::column`], for a source that may be absent.
    ///
    /// # Errors
    /// Fails if its column does not hold numbers.
    pub fn optional(&self, source: ScoreSource) -> Result<Option<&[f64]>, Fault> {
        self.places.get(source).map(|_| self.column(source)).transpose()
    }

    /// One of the columns of a source.
    ///
    /// # Errors
    /// Fails if the line lacks the source or this column, or the column does not hold numbers.
    pub fn named(&self, source: ScoreSource, name: &str) -> Result<&[f64], Fault> {
        floats(&self.line.inputs[self.place(source)?.table], name)
    }

    /// Outcomes of the measurements of the track.
    ///
    /// # Errors
    /// Fails if the line lacks a track, or the track has no text in `update`.
    pub fn updates(&self) -> Result<&StringArray, Fault> {
        let place = self.places.get(ScoreSource::Track).map_or_else(|| self.place(ScoreSource::Innovations), Ok)?;
        let track = &self.line.inputs[place.table];
        let updates = track.column_by_name("update").and_then(|a| a.as_string_opt::<i32>());
        updates.ok_or_else(|| Fault::data("the track has no text column `update`").in_column("update"))
    }

    /// Values of a source with a single column of text.
    ///
    /// # Errors
    /// Fails if the line lacks the source, or its column does not hold text.
    pub fn texts(&self, source: ScoreSource) -> Result<&StringArray, Fault> {
        let ScoreSourceColumns { table, columns } = self.place(source)?;
        let name = columns.first().ok_or_else(|| self.without(source))?;
        let texts = self.line.inputs[*table].column_by_name(name).and_then(|a| a.as_string_opt::<i32>());
        texts.ok_or_else(|| Fault::data("the column is not text").in_column(name))
    }

    fn place(&self, source: ScoreSource) -> Result<&ScoreSourceColumns, Fault> {
        self.places.get(source).ok_or_else(|| self.without(source))
    }

    fn without(&self, source: ScoreSource) -> Fault {
        Fault::data(format!("the line lacks {}", source.words(self.stage)))
    }

    /// Compensated minus truth.
    ///
    /// # Errors
    /// Fails in the cases of [`ScoreLine::column`] for the signal and the truth.
    pub fn error(&self) -> Result<&SeriesMoments, Fault> {
        known(&self.error, || {
            Ok(statistics::error_summary(self.column(ScoreSource::Signal)?, self.column(ScoreSource::Truth)?))
        })
    }

    /// Signal before and after compensation, minus the truth if the line has it.
    ///
    /// # Errors
    /// Fails in the cases of [`ScoreLine::column`] for the signal and the aircraft field, and of
    /// [`ScoreLine::optional`] for the truth.
    pub fn signals(&self) -> Result<&CompensationSignals, Fault> {
        known(&self.signals, || {
            let (mag, aircraft) = (self.column(ScoreSource::Signal)?, self.column(ScoreSource::Aircraft)?);
            let truth = self.optional(ScoreSource::Truth)?;
            let after = |(i, m): (usize, &f64)| m - truth.map_or(0.0, |t| t[i]);
            let after_nt: Vec<f64> = mag.iter().enumerate().map(after).collect();
            let before_nt = after_nt.iter().zip(aircraft).map(|(m, a)| m + a).collect();
            Ok(CompensationSignals { before_nt, after_nt })
        })
    }

    /// Compensated signal minus core field and, if available, diurnal variation, in nT.
    ///
    /// # Errors
    /// Fails in the cases of [`ScoreLine::column`] for the signal and the core field, and of [`ScoreLine::optional`]
    /// for the diurnal variation.
    pub fn measured_anomaly(&self) -> Result<Vec<f64>, Fault> {
        self.anomaly_of(ScoreSource::Signal)
    }

    /// True signal minus core field and diurnal variation, in nT. Without a core field, the linear trend of the signal
    /// over time is subtracted instead.
    ///
    /// # Errors
    /// Fails in the cases of [`ScoreLine::column`] for the truth. With a core field, it also fails in the cases of
    /// [`ScoreLine::optional`] for the core field and the diurnal variation. Without a core field, it also fails in the
    /// cases of [`ScoreLine::tt`].
    pub fn true_anomaly(&self) -> Result<Vec<f64>, Fault> {
        match self.places.get(ScoreSource::Core) {
            Some(_) => self.anomaly_of(ScoreSource::Truth),
            None => Ok(statistics::less_straight_line(self.tt()?, self.column(ScoreSource::Truth)?)),
        }
    }

    /// A field minus the core field and the diurnal variation, unless an earlier stage has removed them.
    fn anomaly_of(&self, field: ScoreSource) -> Result<Vec<f64>, Fault> {
        let (core, diurnal) = (self.column(ScoreSource::Core)?, self.optional(ScoreSource::Diurnal)?);
        let (place, values) = (self.place(field)?, self.column(field)?);
        let shape = TableShape::from_schema(&self.line.inputs[place.table].schema());
        let removed = place.columns.first().map(|name| had(&shape, name)).unwrap_or_default();
        let core = Some(core).filter(|_| !removed.contains(&MagneticCorrection::Core));
        let diurnal = diurnal.filter(|_| !removed.contains(&MagneticCorrection::Diurnal));
        let at = |column: Option<&[f64]>, i: usize| column.map_or(0.0, |x| x[i]);
        Ok(values.iter().enumerate().map(|(i, field)| field - at(core, i) - at(diurnal, i)).collect())
    }

    /// The measured anomaly minus the map.
    ///
    /// # Errors
    /// Fails in the cases of [`ScoreLine::measured_anomaly`], and of [`ScoreLine::named`] for the map.
    pub fn map_error(&self) -> Result<&SeriesMoments, Fault> {
        known(&self.map_error, || {
            Ok(statistics::error_summary(&self.measured_anomaly()?, self.named(ScoreSource::Map, "map_anomaly")?))
        })
    }

    /// Track minus true positions; NaN for the track of a bound, which equals the truth.
    ///
    /// # Errors
    /// Fails in the cases of [`ScoreLine::named`] for the track, and of [`ScoreLine::position`].
    pub fn track_error(&self) -> Result<&HorizontalErrors, Fault> {
        known(&self.track_error, || {
            let HorizontalErrors { north_m, east_m } =
                self.offsets(self.named(ScoreSource::Track, "lat")?, self.named(ScoreSource::Track, "lon")?)?;
            Ok(HorizontalErrors { north_m: self.unless_bound(north_m), east_m: self.unless_bound(east_m) })
        })
    }

    /// Errors of a track; NaN for the track of a bound, which has no estimate.
    pub fn unless_bound(&self, errors: Vec<f64>) -> Vec<f64> {
        if self.places.get(ScoreSource::Bound).is_some() { vec![f64::NAN; errors.len()] } else { errors }
    }

    /// Horizontal distances of the track from the truth, in metres, sorted, without samples of unknown distance.
    ///
    /// # Errors
    /// Fails in the cases of [`ScoreLine::track_error`].
    pub fn radii(&self) -> Result<&[f64], Fault> {
        let radii = known(&self.radii, || {
            let HorizontalErrors { north_m, east_m } = self.track_error()?;
            let mut radii: Vec<f64> = north_m.iter().zip(east_m).map(|(n, e)| n.hypot(*e)).collect();
            radii.retain(|radius| radius.is_finite());
            radii.sort_by(f64::total_cmp);
            Ok(radii)
        })?;
        Ok(radii)
    }

    /// Positions minus the true positions.
    ///
    /// # Errors
    /// Fails in the cases of [`ScoreLine::position`].
    pub fn offsets(&self, lat: &[f64], lon: &[f64]) -> Result<HorizontalErrors, Fault> {
        let (true_lat, true_lon) = self.position()?;
        let offset = |i: usize| EarthModel::default().offset_ne_m((true_lat[i], true_lon[i]), (lat[i], lon[i]), 0.0);
        let (north_m, east_m) = (0..lat.len()).map(offset).unzip();
        Ok(HorizontalErrors { north_m, east_m })
    }

    /// True latitudes and longitudes, in degrees.
    ///
    /// # Errors
    /// Fails in the cases of [`ScoreLine::named`] for the true positions.
    pub fn position(&self) -> Result<(&[f64], &[f64]), Fault> {
        Ok((self.named(ScoreSource::Position, "lat")?, self.named(ScoreSource::Position, "lon")?))
    }
}

fn known<T>(cell: &LazyResult<T>, compute: impl FnOnce() -> Result<T, Fault>) -> Result<&T, Fault> {
    cell.get_or_init(compute).as_ref().map_err(Clone::clone)
}
