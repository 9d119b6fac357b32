//! The rows of a fit as models that learn see them: line by line, as they are.

use std::{borrow::Cow, ops::Range};

use schemas::{Fault, Work};

use super::point::places;

/// The rows of all lines of a fit.
pub struct Samples<'a> {
    /// The names of the columns.
    pub names: &'a [String],
    /// The lines, in their order.
    pub lines: Vec<LineSamples<'a>>,
}

/// The rows of a line.
pub struct LineSamples<'a> {
    /// The flight.
    pub flight: String,
    /// The line, as flight/line.
    pub name: String,
    /// The features, row-major.
    pub x: Cow<'a, [f64]>,
    /// The target.
    pub y: &'a [f64],
    /// The runs of samples that follow each other in time.
    pub runs: &'a [Range<usize>],
    /// Samples a second.
    pub rate_hz: f64,
}

impl LineSamples<'_> {
    /// The line without its flight.
    fn line(&self) -> &str {
        self.name.strip_prefix(&self.flight).and_then(|rest| rest.strip_prefix('/')).unwrap_or(&self.name)
    }

    /// Whether a user's name means it: the line, the flight with all its lines, or flight/line.
    fn is_named(&self, name: &str) -> bool {
        [self.line(), self.flight.as_str(), self.name.as_str()].contains(&name)
    }

    /// Some columns of its rows, row-major.
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

impl Samples<'_> {
    /// The places of the entries `names`, each a name or what several names have before a `_`; of all without.
    ///
    /// # Errors
    /// When an entry is not there or chosen twice, or none is chosen.
    pub fn places(&self, names: Option<&Vec<String>>) -> Result<Vec<usize>, Fault> {
        match names {
            Some(names) => places(names, self.names),
            None => Ok((0..self.names.len()).collect()),
        }
    }

    /// Some columns of some lines, one line behind the other.
    pub fn columns(&self, at: &[usize], lines: &[usize]) -> Vec<f64> {
        let lines = || lines.iter().filter_map(|&i| self.lines.get(i));
        let mut out = Vec::with_capacity(lines().map(|line| line.y.len()).sum::<usize>() * at.len());
        lines().for_each(|line| line.add_columns(at, self.names.len(), &mut out));
        out
    }

    /// The numbers of rows of the runs of some lines.
    pub fn runs(&self, lines: &[usize]) -> Vec<usize> {
        let lines = lines.iter().filter_map(|&i| self.lines.get(i));
        lines.flat_map(|line| line.runs.iter().map(Range::len)).collect()
    }

    /// The rate of all lines, Hz.
    ///
    /// # Errors
    /// When they differ by more than a hundredth.
    pub fn rate_hz(&self) -> Result<f64, Fault> {
        let rates = || self.lines.iter().map(|line| line.rate_hz);
        let (least, most) = (rates().fold(f64::INFINITY, f64::min), rates().fold(0.0, f64::max));
        if most > 1.01 * least {
            let what = format!("the lines have from {least} to {most} samples a second, and a window needs one rate");
            return Err(Fault::data(what).help("add a `resample` stage before this one"));
        }
        Ok(most)
    }

    /// The target of some lines.
    pub fn target(&self, lines: &[usize]) -> Vec<f64> {
        lines.iter().filter_map(|&i| self.lines.get(i)).flat_map(|line| line.y.to_vec()).collect()
    }

    /// The lines to train on, and those that the user names to validate with.
    ///
    /// # Errors
    /// When a name is that of no line of the fit, or no line is left to train on.
    pub fn split(&self, validation: &[String]) -> Result<(Vec<usize>, Vec<usize>), Fault> {
        let wrong = |what: String| Fault::data(what).of_param("validation");
        if let Some(name) = validation.iter().find(|name| !self.lines.iter().any(|line| line.is_named(name))) {
            let known: Vec<String> = self.lines.iter().map(|line| line.name.clone()).collect();
            return Err(wrong(format!("`{name}` is no line of the fit, and no flight")).nearest(name, &known));
        }
        let is_validation = |i: &usize| validation.iter().any(|name| self.lines[*i].is_named(name));
        let (validate, train): (Vec<usize>, Vec<usize>) = (0..self.lines.len()).partition(is_validation);
        if train.is_empty() {
            return Err(wrong("no line is left to train on".to_owned()).help("select more lines in `where`"));
        }
        Ok((train, validate))
    }
}

/// Start, stored state and messages of one point of a sweep during training.
pub struct PointWork<'a> {
    /// That of all points.
    pub work: &'a dyn Work,
    /// The point's place among them.
    pub point: usize,
}

impl PointWork<'_> {
    /// See [`Work::kept`].
    pub fn kept(&self) -> Option<Vec<u8>> {
        self.work.kept(self.point)
    }

    /// See [`Work::keep`].
    pub fn keep(&self, state: &[u8]) {
        self.work.keep(self.point, state);
    }

    /// See [`Work::goes_on`].
    ///
    /// # Errors
    /// When it does not go on.
    pub fn goes_on(&self, progress: &str) -> Result<(), Fault> {
        let stopped = || Fault::machine("interrupted").help("run it again: it goes on from where it was");
        if self.work.goes_on(self.point, progress).is_break() { Err(stopped()) } else { Ok(()) }
    }
}
