//! Rows of a fit for models that learn from samples: line by line, unfiltered.

use std::{borrow::Cow, ops::Range};

use schemas::{CheckpointMonitor, Fault};

use super::point::places;

/// Rows of all lines of a fit.
pub struct FitSamples<'a> {
    /// Names of the columns.
    pub names: &'a [String],
    /// Lines in order.
    pub lines: Vec<LineSamples<'a>>,
}

/// Rows of a line.
pub struct LineSamples<'a> {
    /// Flight of the line.
    pub flight: String,
    /// The line, as flight/line.
    pub name: String,
    /// Features, row-major.
    pub x: Cow<'a, [f64]>,
    /// Target of each row.
    pub y: &'a [f64],
    /// Runs of consecutive samples.
    pub runs: &'a [Range<usize>],
    /// Sample rate, in Hz.
    pub rate_hz: f64,
}

impl LineSamples<'_> {
    /// Name of the line without its flight.
    fn line(&self) -> &str {
        self.name.strip_prefix(&self.flight).and_then(|rest| rest.strip_prefix('/')).unwrap_or(&self.name)
    }

    /// Returns whether a name refers to this line: the line, its flight, or flight/line.
    fn is_named(&self, name: &str) -> bool {
        [self.line(), self.flight.as_str(), self.name.as_str()].contains(&name)
    }

    /// The columns `at` of the line's rows, row-major.
    pub fn columns(&self, at: &[usize], width: usize) -> Vec<f64> {
        let mut out = Vec::with_capacity(self.y.len() * at.len());
        self.add_columns(at, width, &mut out);
        out
    }

    fn add_columns(&self, at: &[usize], width: usize, out: &mut Vec<f64>) {
        for row in self.x.chunks_exact(width.max(1)) {
            out.extend(at.iter().filter_map(|&i| row.get(i)));
        }
    }
}

impl FitSamples<'_> {
    /// Positions of the entries `names`, each a name or a prefix of several names before a `_`. All positions without
    /// `names`.
    ///
    /// # Errors
    /// Fails if an entry is missing or chosen twice, or no entry is chosen.
    pub fn places(&self, names: Option<&Vec<String>>) -> Result<Vec<usize>, Fault> {
        match names {
            Some(names) => places(names, self.names),
            None => Ok((0..self.names.len()).collect()),
        }
    }

    /// Columns of some lines, joined.
    pub fn columns(&self, at: &[usize], lines: &[usize]) -> Vec<f64> {
        let lines = || lines.iter().filter_map(|&i| self.lines.get(i));
        let mut out = Vec::with_capacity(lines().map(|line| line.y.len()).sum::<usize>() * at.len());
        lines().for_each(|line| line.add_columns(at, self.names.len(), &mut out));
        out
    }

    /// Lengths of the runs of some lines.
    pub fn runs(&self, lines: &[usize]) -> Vec<usize> {
        let lines = lines.iter().filter_map(|&i| self.lines.get(i));
        lines.flat_map(|line| line.runs.iter().map(Range::len)).collect()
    }

    /// Sample rate of all lines, in Hz.
    ///
    /// # Errors
    /// Fails if the rates differ by more than 1 %.
    pub fn rate_hz(&self) -> Result<f64, Fault> {
        let rates = || self.lines.iter().map(|line| line.rate_hz);
        let (least, most) = (rates().fold(f64::INFINITY, f64::min), rates().fold(0.0, f64::max));
        if most > 1.01 * least {
            let what = format!("the lines have sample rates from {least} to {most} Hz, but a window requires one rate");
            return Err(Fault::data(what).help("add a `resample` stage before this one"));
        }
        Ok(most)
    }

    /// Target of some lines.
    pub fn target(&self, lines: &[usize]) -> Vec<f64> {
        lines.iter().filter_map(|&i| self.lines.get(i)).flat_map(|line| line.y.to_vec()).collect()
    }

    /// Training lines, and the lines that the user names for validation.
    ///
    /// # Errors
    /// Fails if a name matches no line of the fit, or no training line remains.
    pub fn split(&self, validation: &[String]) -> Result<(Vec<usize>, Vec<usize>), Fault> {
        let wrong = |what: String| Fault::data(what).of_param("validation");
        if let Some(name) = validation.iter().find(|name| !self.lines.iter().any(|line| line.is_named(name))) {
            let known: Vec<String> = self.lines.iter().map(|line| line.name.clone()).collect();
            return Err(wrong(format!("`{name}` is neither a line nor a flight of the fit")).nearest(name, &known));
        }
        let is_validation = |i: &usize| validation.iter().any(|name| self.lines[*i].is_named(name));
        let (validate, train): (Vec<usize>, Vec<usize>) = (0..self.lines.len()).partition(is_validation);
        if train.is_empty() {
            return Err(wrong("no line remains for training".to_owned())
                .help("select more lines with `where`, or name fewer in `validation`"));
        }
        Ok((train, validate))
    }
}

/// Saved state, storage and progress of one point of a sweep during training.
pub struct PointMonitor<'a> {
    /// Storage and progress of all points.
    pub work: &'a dyn CheckpointMonitor,
    /// Index of the point among all points.
    pub point: usize,
}

impl PointMonitor<'_> {
    /// See [`CheckpointMonitor::kept`].
    pub fn kept(&self) -> Option<Vec<u8>> {
        self.work.kept(self.point)
    }

    /// See [`CheckpointMonitor::keep`].
    pub fn keep(&self, state: &[u8]) {
        self.work.keep(self.point, state);
    }

    /// See [`CheckpointMonitor::report_progress`].
    ///
    /// # Errors
    /// Fails if the run is interrupted.
    pub fn report_progress(&self, progress: &str) -> Result<(), Fault> {
        let stopped = || Fault::machine("interrupted").help("run the same command again to resume");
        if self.work.report_progress(self.point, progress).is_break() { Err(stopped()) } else { Ok(()) }
    }
}
