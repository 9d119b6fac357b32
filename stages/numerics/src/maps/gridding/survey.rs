//! The points of a survey, and their cleaning.

use super::far::far_points;
use crate::regression::statistics::median;

/// Points of a survey; the points of a line are consecutive and in flight order.
#[derive(Clone, Copy, Debug)]
pub struct SurveyPoints<'a> {
    /// Easting on a plane, in metres.
    pub easting_m: &'a [f64],
    /// Northing on the same plane, in metres.
    pub northing_m: &'a [f64],
    /// Height of the sensor, in metres.
    pub height_m: &'a [f64],
    /// Anomaly, in nT, without the core field and the diurnal variation.
    pub value_nt: &'a [f64],
    /// The line that each point belongs to.
    pub line: &'a [usize],
}

/// Points of a survey with owned columns.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OwnedSurveyPoints {
    /// Easting, in metres.
    pub easting_m: Vec<f64>,
    /// Northing, in metres.
    pub northing_m: Vec<f64>,
    /// Height, in metres.
    pub height_m: Vec<f64>,
    /// Anomaly, in nT.
    pub value_nt: Vec<f64>,
    /// Line.
    pub line: Vec<usize>,
}

impl OwnedSurveyPoints {
    /// Borrowed points.
    pub fn borrow(&self) -> SurveyPoints<'_> {
        SurveyPoints {
            easting_m: &self.easting_m,
            northing_m: &self.northing_m,
            height_m: &self.height_m,
            value_nt: &self.value_nt,
            line: &self.line,
        }
    }
}

impl SurveyPoints<'_> {
    /// The number of points: the length of the shortest column.
    pub fn len(&self) -> usize {
        let columns = [self.easting_m, self.northing_m, self.height_m, self.value_nt].map(<[f64]>::len);
        columns.into_iter().chain([self.line.len()]).min().unwrap_or(0)
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The points with these indices; an index past the end is ignored.
    pub fn pick(&self, indices: &[usize]) -> OwnedSurveyPoints {
        let take = |column: &[f64]| indices.iter().filter_map(|&i| column.get(i).copied()).collect();
        OwnedSurveyPoints {
            easting_m: take(self.easting_m),
            northing_m: take(self.northing_m),
            height_m: take(self.height_m),
            value_nt: take(self.value_nt),
            line: indices.iter().filter_map(|&i| self.line.get(i).copied()).collect(),
        }
    }

    /// Start and end of each run of points of one line.
    pub fn runs(&self) -> Vec<std::ops::Range<usize>> {
        let mut runs: Vec<std::ops::Range<usize>> = Vec::new();
        for i in 0..self.len() {
            match runs.last_mut() {
                Some(run) if self.line[run.start] == self.line[i] => run.end = i + 1,
                _ => runs.push(i..i + 1),
            }
        }
        runs
    }

    /// The lines, ascending.
    pub fn lines(&self) -> Vec<usize> {
        let mut lines = self.line[..self.len()].to_vec();
        lines.sort_unstable();
        lines.dedup();
        lines
    }

    fn apart_m(&self, i: usize, j: usize) -> f64 {
        (self.easting_m[i] - self.easting_m[j]).hypot(self.northing_m[i] - self.northing_m[j])
    }
}

/// The criteria of cleaning.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CleaningOptions {
    /// Outlier limit: maximum distance of a point from the straight line between its neighbours in flight order, in
    /// robust standard deviations of the surroundings; zero keeps all.
    pub sigmas: f64,
    /// Minimum distance of an outlier from the straight line between its neighbours, in nT.
    pub floor_nt: f64,
    /// Number of points on either side of a point that form its surroundings.
    pub half_window: usize,
    /// Minimum number of points of a line; shorter lines are excluded.
    pub shortest_line: usize,
    /// Whether points far from all others are excluded, see [`far_points`].
    pub without_far: bool,
}

impl Default for CleaningOptions {
    /// Ten robust standard deviations among 51 points, and at least 10 nT; the anomaly changes by less between two
    /// points.
    fn default() -> Self {
        Self { sigmas: 10.0, floor_nt: 10.0, half_window: 25, shortest_line: 5, without_far: true }
    }
}

/// Indices of points, ascending, by the outcome of cleaning.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CleaningOutcome {
    /// Kept points.
    pub kept: Vec<usize>,
    /// Points with a coordinate or value that is not a finite number.
    pub not_finite: Vec<usize>,
    /// Points far from all others.
    pub far: Vec<usize>,
    /// Points at the same position as the line's previous point.
    pub duplicates: Vec<usize>,
    /// Points that are outliers along their line.
    pub outliers: Vec<usize>,
    /// Points of lines that are too short.
    pub of_short_lines: Vec<usize>,
}

/// Sorts the points of a survey into kept and excluded points.
pub fn clean(points: SurveyPoints, options: &CleaningOptions) -> CleaningOutcome {
    let mut cleaned = CleaningOutcome::default();
    if options.without_far {
        cleaned.far = far_points(points.easting_m, points.northing_m);
    }
    for run in points.runs() {
        let mut kept: Vec<usize> = Vec::with_capacity(run.len());
        for i in run {
            let sum = points.easting_m[i] + points.northing_m[i] + points.height_m[i] + points.value_nt[i];
            let again = kept
                .last()
                .is_some_and(|&last| points.apart_m(i, last) == 0.0 && points.height_m[i] == points.height_m[last]);
            match () {
                () if cleaned.far.binary_search(&i).is_ok() => {}
                () if !sum.is_finite() => cleaned.not_finite.push(i),
                () if again => cleaned.duplicates.push(i),
                () => kept.push(i),
            }
        }
        let spikes = spikes(points, &kept, options);
        kept.retain(|i| spikes.binary_search(i).is_err());
        cleaned.outliers.extend(spikes);
        if kept.len() < options.shortest_line {
            cleaned.of_short_lines.extend(kept);
        } else {
            cleaned.kept.extend(kept);
        }
    }
    cleaned
}

/// Outliers of a line. Points next to a larger outlier are tested again after its removal.
fn spikes(points: SurveyPoints, line: &[usize], options: &CleaningOptions) -> Vec<usize> {
    let (mut left, mut found) = (line.to_vec(), Vec::new());
    while options.sigmas > 0.0 && left.len() >= 5 {
        let away = off_neighbours(points, &left);
        let worst = |k: usize| {
            let beside = k.saturating_sub(2)..(k + 3).min(away.len());
            away[beside].iter().all(|other| other.abs() <= away[k].abs())
        };
        let limit = |k: usize| {
            let around = k.saturating_sub(options.half_window)..(k + options.half_window + 1).min(away.len());
            let mut sizes: Vec<f64> = away[around].iter().map(|a| a.abs()).collect();
            (options.sigmas * 1.4826 * median(&mut sizes)).max(options.floor_nt)
        };
        let out = |&k: &usize| away[k].abs() > options.floor_nt && worst(k) && away[k].abs() > limit(k);
        let spikes: Vec<usize> = (0..left.len()).filter(out).map(|k| left[k]).collect();
        if spikes.is_empty() {
            break;
        }
        left.retain(|i| spikes.binary_search(i).is_err());
        found.extend(spikes);
    }
    found.sort_unstable();
    found
}

/// The distance of each point's value from the straight line between the values of its neighbours; zero at the ends.
fn off_neighbours(points: SurveyPoints, line: &[usize]) -> Vec<f64> {
    let mut away = vec![0.0; line.len()];
    for (k, three) in line.windows(3).enumerate() {
        let (before, after) = (points.apart_m(three[0], three[1]), points.apart_m(three[1], three[2]));
        let part = before / (before + after).max(f64::MIN_POSITIVE);
        let [a, v, b] = [0, 1, 2].map(|j| points.value_nt[three[j]]);
        away[k + 1] = v - (a + part * (b - a));
    }
    away
}
