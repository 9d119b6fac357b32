//! The models of a sweep from the moments of its lines.

use std::{borrow::Cow, collections::BTreeMap, sync::Arc};

use numerics::{
    compensation::diagnostics::{Excitation, TrivialSolution, approximation_bound_nt, excitation, trivial_solution},
    regression::{
        choose_lambda::{self, by_generalised_cross_validation, by_l_curve, by_lines, curve},
        elastic_net::ElasticNet,
        least_squares::{LineScore, LineScores, LinearFit, Moments, Prepared, RidgePath, Scaling},
        pls,
        recursive_least_squares::RecursiveLeastSquares,
        robust::{LineRows, Loss, Robust, Scale},
        truncated_svd,
    },
};
use schemas::Fault;

use super::{
    Fit, Matrix, Targets,
    components::Components,
    rows::{Part, Share},
};
use crate::columns::data;

/// Values on the grid of ridge parameters where the spec gives none, over so many decades below the largest.
const GRID: (usize, f64) = (81, 1e-12);
/// Values on a path of the elastic net, and its smallest as a part of its largest.
const PATH: (usize, f64) = (100, 1e-4);
/// Directions with less than this part of the strongest's excitation are named.
const WEAK: f64 = 1e-4;

/// What the size of a total field can be on earth.
const TOTAL_NT: std::ops::Range<f64> = 20_000.0..80_000.0;

/// A fitted model, ready for its table.
pub struct Solved {
    /// Coefficients in the units of the columns.
    pub fit: LinearFit,
    /// One sigma of each coefficient; NaN where the model knows none.
    pub std: Vec<f64>,
    /// The names of the terms.
    pub terms: Vec<String>,
    /// Rows that were used, and rows of the selected lines that were not.
    pub rows: (usize, usize),
    /// The condition number of the scaled matrix.
    pub condition: f64,
    /// Standard deviation of what is left of the filtered target.
    pub residual_std: f64,
    /// The ridge parameter or number of components that was used.
    pub chosen: f64,
    /// How much of the total field is explained away; NaN where the terms cannot tell.
    pub trivial_share: f64,
    /// What the linear form misses at most; NaN where the terms cannot tell.
    pub approximation_bound_nt: f64,
    /// The lines whose rows were used.
    pub lines: String,
    /// What the user should know before he trusts it.
    pub warning: String,
}

/// What is left of a target, what the coefficients' errors are, and what was chosen.
struct Answer {
    fit: LinearFit,
    std: Vec<f64>,
    residual_std: f64,
    chosen: f64,
}

/// All lines of one matrix and target.
pub struct Problem<'a> {
    shares: Vec<&'a Share>,
    /// The flight of each share.
    flights: Vec<String>,
    /// The lines used, and what is said of those of which nothing is.
    lines: Vec<String>,
    unused: String,
    /// Which of the matrix' columns are used; `None` for all of them.
    places: Option<Vec<usize>>,
    pub(super) merged: Moments,
    /// Of some rows of all lines as they were before the filter.
    pub(super) unfiltered: Option<Moments>,
    pub(super) terms: Vec<String>,
    selected: usize,
    prepared: BTreeMap<(u8, bool), (Arc<Prepared>, Arc<Excitation>)>,
    paths: BTreeMap<(u8, bool), Arc<RidgePath>>,
    /// The terms that the features were replaced by, and the names of the features.
    pub(super) components: Option<Components>,
}

impl<'a> Problem<'a> {
    /// Gathers the lines' shares, in the order of the lines.
    pub fn new(parts: &[&'a Part], at: &(Matrix, Targets)) -> Result<Self, Fault> {
        let terms = parts.iter().find_map(|p| p.terms.get(&at.0));
        let terms = terms.ok_or_else(|| Fault::data("no selected line has the features of the fit"))?;
        let all: Vec<(&Part, &Share)> = parts.iter().filter_map(|p| p.shares.get(at).map(|s| (*p, s))).collect();
        let selected = all.iter().map(|(_, s)| s.selected).sum();
        let (used, unused): (Vec<_>, Vec<_>) = all.into_iter().partition(|(_, s)| s.moments.rows() > 0);
        let unused = too_short(&unused);
        if used.is_empty() {
            let what = format!(
                "no run of samples with `{}` and all features is long enough to be filtered and trimmed: {unused}",
                at.1.join("`, `")
            );
            return Err(Fault::data(what).help("select longer lines, or take a smaller `trim` or `order`"));
        }
        let lines = used.iter().map(|(p, _)| format!("{}/{}", p.flight, p.line)).collect();
        let (flights, shares): (Vec<String>, Vec<&Share>) =
            used.into_iter().map(|(p, s)| (p.flight.clone(), s)).unzip();
        let moments: Vec<Moments> = shares.iter().map(|s| s.moments.clone()).collect();
        let merged = Moments::merged(&moments).map_err(data)?;
        let unfiltered: Vec<Moments> = shares.iter().filter_map(|s| s.unfiltered.clone()).collect();
        let unfiltered = Moments::merged(&unfiltered).ok();
        let (prepared, paths) = (BTreeMap::new(), BTreeMap::new());
        let (terms, components) = (terms.clone(), None);
        let places = None;
        Ok(Self {
            shares,
            flights,
            lines,
            unused,
            places,
            merged,
            unfiltered,
            terms,
            selected,
            prepared,
            paths,
            components,
        })
    }

    /// What is left out one after the other: the lines, or all lines of a flight together.
    fn groups(&self, point: &Fit) -> Result<Vec<Moments>, Fault> {
        let lines = self.lines()?;
        if point.choose != "leave_one_flight_out" {
            return Ok(lines);
        }
        let mut flights: Vec<(&String, Vec<Moments>)> = vec![];
        for (flight, line) in self.flights.iter().zip(lines) {
            match flights.iter_mut().find(|(f, _)| *f == flight) {
                Some((_, lines)) => lines.push(line),
                None => flights.push((flight, vec![line])),
            }
        }
        flights.iter().map(|(_, lines)| Moments::merged(lines).map_err(data)).collect()
    }

    /// The same with the entries of `point` alone, from the factor of all.
    pub fn cut(&self, point: &Fit) -> Result<Problem<'a>, Fault> {
        let places = point.places(&self.terms)?;
        let own = |moments: &Moments| own(moments, places.as_deref());
        let (merged, unfiltered) = (own(&self.merged)?, self.unfiltered.as_ref().map(own).transpose()?);
        let terms = match &places {
            Some(places) => places.iter().filter_map(|&i| self.terms.get(i).cloned()).collect(),
            None => self.terms.clone(),
        };
        Ok(Problem {
            shares: self.shares.clone(),
            flights: self.flights.clone(),
            lines: self.lines.clone(),
            unused: self.unused.clone(),
            places,
            merged,
            unfiltered,
            terms,
            selected: self.selected,
            prepared: BTreeMap::new(),
            paths: BTreeMap::new(),
            components: None,
        })
    }

    /// The moments of each line.
    fn lines(&self) -> Result<Vec<Moments>, Fault> {
        let own = |s: &&Share| {
            let own = own(&s.moments, self.places.as_deref())?;
            match &self.components {
                Some(components) => components.of(&own),
                None => Ok(own),
            }
        };
        self.shares.iter().map(own).collect()
    }

    /// The rows of each line: terms row-major, and the target.
    fn rows(&self) -> Vec<(Cow<'a, [f64]>, &'a [f64])> {
        let own = |share: &'a Share| {
            let (a, y) = share.rows.as_ref()?;
            let a = match &self.places {
                Some(places) => {
                    let width = a.len() / y.len().max(1);
                    let row = |row: &'a [f64]| places.iter().map(|&i| row[i]).collect::<Vec<_>>();
                    Cow::Owned(a.chunks_exact(width.max(1)).flat_map(row).collect())
                }
                None => Cow::Borrowed(a.as_slice()),
            };
            Some((a, y.as_slice()))
        };
        self.shares.iter().filter_map(|s| own(s)).collect()
    }

    /// The columns on one scale, and which of their directions the flight excites.
    fn prepared(&mut self, point: &Fit) -> Result<(Arc<Prepared>, Arc<Excitation>), Fault> {
        let (scaling, intercept) = (point.scaling(), point.intercept());
        let key = (scaling as u8, intercept);
        if let Some(known) = self.prepared.get(&key) {
            return Ok(known.clone());
        }
        let prepared = self.merged.prepare(scaling, intercept).map_err(data)?;
        let excited = excitation(&prepared, &self.terms, WEAK).map_err(data)?;
        let made = (Arc::new(prepared), Arc::new(excited));
        self.prepared.insert(key, made.clone());
        Ok(made)
    }

    /// Solves for ridge parameters of all points of a kind at once: `lambdas` are those of the sweep.
    pub fn solve_ridges(&mut self, point: &Fit, lambdas: &[f64]) -> Result<(), Fault> {
        let (prepared, _) = self.prepared(point)?;
        // Where one cannot be solved, such as 0 with terms that nothing excites, each is tried by itself later.
        if let Ok(path) = prepared.ridge(lambdas, &self.terms) {
            self.paths.insert((point.scaling() as u8, point.intercept()), Arc::new(path));
        }
        Ok(())
    }

    /// The model of one point.
    pub fn solve(&mut self, point: &Fit) -> Result<Solved, Fault> {
        let (prepared, excited) = self.prepared(point)?;
        let answer = match point.model.as_str() {
            "elastic_net" => self.elastic_net(point),
            "pls" => self.pls(point),
            "truncated_svd" => self.truncated(point, &prepared),
            "robust" => self.robust(point),
            "recursive_least_squares" => self.recursive(point),
            _ => self.ridge(point, &prepared),
        }?;
        let trivial = self.trivial(&answer)?;
        let approximation_bound_nt = self.approximation_bound_nt(&answer);
        let used = self.merged.rows();
        let (fit, std, terms) = match &self.components {
            Some(components) => components.original(&answer.fit),
            None => (answer.fit, answer.std, self.terms.clone()),
        };
        Ok(Solved {
            fit,
            std,
            terms,
            rows: (used, self.selected - used),
            condition: excited.condition,
            residual_std: answer.residual_std,
            chosen: answer.chosen,
            approximation_bound_nt,
            trivial_share: trivial.as_ref().map_or(f64::NAN, |t| t.share),
            lines: self.lines.join(", "),
            warning: warning(point, &excited, trivial.as_ref(), &self.unused),
        })
    }

    fn ridge(&self, point: &Fit, prepared: &Prepared) -> Result<Answer, Fault> {
        let lambda = match point.choose.as_str() {
            "given" => point.lambda,
            how => self.best_lambda(point, prepared, how)?,
        };
        let known = self.paths.get(&(point.scaling() as u8, point.intercept()));
        let found = |path: &RidgePath| path.solutions.iter().position(|s| s.lambda.to_bits() == lambda.to_bits());
        let (path, at) = match known.and_then(|path| found(path).map(|at| (path.clone(), at))) {
            Some(known) => known,
            None => (Arc::new(prepared.ridge(&[lambda], &self.terms).map_err(data)?), 0),
        };
        let solution = path.solutions.get(at).ok_or_else(|| Fault::machine("a fit was lost"))?;
        let values = solution.coefficients.first().cloned().unwrap_or_default();
        let covariance = path.covariance(at, 0).unwrap_or_default();
        let p = values.len();
        let std = (0..p).map(|i| covariance.get(i * p + i).map_or(f64::NAN, |v| v.sqrt())).collect();
        let scaled = prepared.scaled(&values);
        let residual_std = solution.residual_variances.first().map_or(f64::NAN, |v| v.sqrt());
        let intercept = prepared.original(0, &scaled).intercept;
        Ok(Answer { fit: LinearFit { coefficients: values, intercept }, std, residual_std, chosen: lambda })
    }

    fn best_lambda(&self, point: &Fit, prepared: &Prepared, how: &str) -> Result<f64, Fault> {
        let grid = match &point.lambdas {
            Some(given) => {
                let mut grid = given.clone();
                grid.sort_by(f64::total_cmp);
                grid
            }
            None => {
                let singular = prepared.singular().map_err(data)?;
                let largest = singular.values.first().copied().unwrap_or(1.0).powi(2);
                choose_lambda::grid(GRID.1 * largest, largest, GRID.0).map_err(data)?
            }
        };
        if point.leaves_out() {
            let falling: Vec<f64> = grid.iter().rev().copied().collect();
            let scores =
                by_lines(&self.groups(point)?, 0, &falling, point.scaling(), point.intercept(), LineScore::Variance);
            let at = self.pick(point, &scores.map_err(lines_needed)?);
            return falling.get(at).copied().ok_or_else(|| Fault::data("there is no ridge parameter to choose"));
        }
        let points = curve(prepared, 0, &grid).map_err(data)?;
        let (at, none) = if how == "gcv" {
            (
                by_generalised_cross_validation(&points),
                "generalised cross-validation is not defined: there are too few rows",
            )
        } else {
            (by_l_curve(&points), "the L-curve has no corner")
        };
        let at = at.ok_or_else(|| Fault::data(none).help("give `lambda`, or `lambdas` over another range"))?;
        Ok(points[at].lambda)
    }

    fn pick(&self, point: &Fit, scores: &LineScores) -> usize {
        if point.one_standard_error { scores.within_one_error } else { scores.best }
    }

    fn elastic_net(&self, point: &Fit) -> Result<Answer, Fault> {
        let net = ElasticNet {
            l1_ratio: point.l1_ratio,
            scaling: point.scaling(),
            intercept: point.intercept(),
            ..ElasticNet::default()
        };
        let found = if point.leaves_out() {
            let alphas = match &point.lambdas {
                Some(given) => {
                    let mut falling = given.clone();
                    falling.sort_by(|a, b| b.total_cmp(a));
                    falling
                }
                None => net.alphas(&self.merged, 0, PATH.0, PATH.1).map_err(data)?,
            };
            let choice = net.choose(&self.groups(point)?, 0, &alphas, LineScore::Variance).map_err(lines_needed)?;
            let at = self.pick(point, &choice.scores);
            choice.path.into_iter().nth(at)
        } else {
            net.path(&self.merged, 0, &[point.lambda]).map_err(data)?.pop()
        };
        let found = found.ok_or_else(|| Fault::machine("a fit was lost"))?;
        let free = self.free(found.active.len(), point);
        Ok(self.answer(found.fit, (found.residual_squares / free).sqrt(), found.alpha))
    }

    fn pls(&self, point: &Fit) -> Result<Answer, Fault> {
        let targets: Vec<usize> = (0..self.merged.targets()).collect();
        let most = point.components.min(self.terms.len());
        let count = if point.leaves_out() {
            let scores =
                pls::choose_components(&self.groups(point)?, &targets, 0, most, point.scaling(), LineScore::Variance);
            1 + self.pick(point, &scores.map_err(lines_needed)?)
        } else {
            most
        };
        let mut path = pls::fit(&self.merged, &targets, count, point.scaling()).map_err(data)?;
        let squares = path.residual_squares.pop().and_then(|s| s.first().copied()).unwrap_or(f64::NAN);
        let used = path.fits.len();
        let fit = path.fits.pop().and_then(|f| f.into_iter().next());
        let fit = fit.ok_or_else(|| Fault::data("the target has no covariance with any feature"))?;
        Ok(self.answer(fit, (squares / self.free(used, point)).sqrt(), used as f64))
    }

    fn truncated(&self, point: &Fit, prepared: &Prepared) -> Result<Answer, Fault> {
        let most = point.components.min(self.terms.len());
        let count = if point.leaves_out() {
            let scores = truncated_svd::choose_components(
                &self.groups(point)?,
                0,
                most,
                point.scaling(),
                point.intercept(),
                LineScore::Variance,
            );
            1 + self.pick(point, &scores.map_err(lines_needed)?)
        } else {
            most
        };
        let fits = truncated_svd::path(prepared, 0).map_err(data)?;
        let fit = fits.into_iter().take(count).next_back().ok_or_else(|| Fault::data("no feature varies"))?;
        let free = self.free(fit.components, point);
        Ok(self.answer(fit.fit, (fit.residual_squares / free).sqrt(), fit.components as f64))
    }

    fn robust(&self, point: &Fit) -> Result<Answer, Fault> {
        let loss = if point.loss == "huber" {
            Loss::Huber { threshold: point.threshold }
        } else {
            Loss::StudentT { degrees: point.degrees_of_freedom }
        };
        let scale = if point.scale == "mad" { Scale::Mad } else { Scale::Joint };
        let robust = Robust { loss, scale, lambda: point.lambda, intercept: point.intercept(), ..Robust::default() };
        let rows = self.rows();
        let rows: Vec<LineRows> = rows.iter().map(|(a, y)| LineRows { a, y }).collect();
        let found = robust.fit(&rows, &self.terms).map_err(data)?;
        if !found.converged {
            let what = format!("the robust fit did not settle within {} passes over the rows", found.passes);
            return Err(Fault::data(what).help("give `lambda` above 0, or leave features out"));
        }
        Ok(self.answer(found.fit, found.scale, point.lambda))
    }

    fn recursive(&self, point: &Fit) -> Result<Answer, Fault> {
        let p = self.terms.len();
        let deviations = self.merged.term_deviations();
        // A ridge of scaled columns: the prior's sigma of a coefficient goes with one over the column's deviation.
        let sigma = |d: &f64| {
            1.0 / (point.lambda.sqrt() * if point.scaling() == Scaling::None || *d == 0.0 { 1.0 } else { *d })
        };
        let sigma: Vec<f64> = deviations.iter().map(sigma).collect();
        let mut filter = RecursiveLeastSquares::new(&vec![0.0; p], &sigma, point.forgetting, true).map_err(data)?;
        for (a, y) in self.rows() {
            for (row, y) in a.chunks_exact(p.max(1)).zip(y) {
                filter.update(row, *y).map_err(data)?;
            }
        }
        let fit = LinearFit { coefficients: filter.coefficients(), intercept: 0.0 };
        let squares = self.merged.residuals(0, &fit).map_err(data)?.squares;
        Ok(self.answer(fit, (squares / self.free(p, point)).sqrt(), point.lambda))
    }

    /// Rows that are left for the residuals' variance.
    fn free(&self, parameters: usize, point: &Fit) -> f64 {
        self.merged.rows() as f64 - parameters as f64 - f64::from(u8::from(point.intercept()))
    }

    fn answer(&self, fit: LinearFit, residual_std: f64, chosen: f64) -> Answer {
        Answer { std: vec![f64::NAN; fit.coefficients.len()], fit, residual_std, chosen }
    }

    /// The size of the total field and the scale of the induced terms, of rows that were not filtered: these terms add
    /// up to the field over their scale. `None` for another target than a total field, and for other terms.
    fn field(&self) -> Option<(f64, f64)> {
        // Without a filter the rows themselves are as they were.
        let unfiltered = self.unfiltered.as_ref().unwrap_or(&self.merged);
        let means = unfiltered.term_means();
        let mean = |name: &str| means.get(self.terms.iter().position(|t| t == name)?).copied();
        let total_nt = unfiltered.target_means().first().copied()?;
        let scale_nt = total_nt / (mean("xx")? + mean("yy")? + mean("zz")?);
        (scale_nt.is_finite() && TOTAL_NT.contains(&total_nt)).then_some((total_nt, scale_nt))
    }

    /// What the model's linear form misses at most; NaN where its terms cannot say that.
    fn approximation_bound_nt(&self, answer: &Answer) -> f64 {
        let Some((field_nt, scale_nt)) = self.field() else { return f64::NAN };
        let value = |name: &str| {
            let at = self.terms.iter().position(|t| t == name);
            at.and_then(|at| answer.fit.coefficients.get(at)).copied().unwrap_or(0.0)
        };
        let permanent_nt = ["x", "y", "z"].map(value);
        let induced = ["xx", "xy", "xz", "yy", "yz", "zz"].map(|name| value(name) / scale_nt);
        approximation_bound_nt(permanent_nt, induced, field_nt)
    }

    /// How near the fit is to calling the whole field the aircraft's; `None` where its terms cannot say that.
    fn trivial(&self, answer: &Answer) -> Result<Option<TrivialSolution>, Fault> {
        let Some(unfiltered) = &self.unfiltered else { return Ok(None) };
        let Some((_, scale_nt)) = self.field() else { return Ok(None) };
        trivial_solution(unfiltered, &self.merged, 0, &self.terms, &answer.fit, answer.chosen, scale_nt).map_err(data)
    }
}

/// The moments of the columns at `places` alone; of all without.
fn own(moments: &Moments, places: Option<&[usize]>) -> Result<Moments, Fault> {
    match places {
        Some(places) => moments.select(places, &(0..moments.targets()).collect::<Vec<_>>()).map_err(data),
        None => Ok(moments.clone()),
    }
}

fn lines_needed(error: numerics::regression::least_squares::LeastSquaresError) -> Fault {
    data(error).help("leaving one out needs two or more lines, or flights: select more, or choose otherwise")
}

/// As many lines are named one by one.
const NAMED: usize = 5;

/// Of which selected lines nothing can be used, and why; empty where there are none.
fn too_short(lines: &[(&Part, &Share)]) -> String {
    let lines: Vec<&(&Part, &Share)> = lines.iter().filter(|(_, s)| s.selected > 0).collect();
    let one = |(part, share): &&(&Part, &Share)| {
        let (has, least) = share.longest;
        format!("flight {}, line {} has {has} samples in its longest run and takes {least}", part.flight, part.line)
    };
    let mut named: Vec<String> = lines.iter().take(NAMED).map(one).collect();
    let more = lines.len().saturating_sub(NAMED);
    if more > 0 {
        named.push(format!("and {more} more"));
    }
    named.join("; ")
}

fn warning(point: &Fit, excited: &Excitation, trivial: Option<&TrivialSolution>, unused: &str) -> String {
    let nothing_given = point.choose == "given" && point.lambda == 0.0;
    let weak = excited.message().filter(|_| nothing_given);
    let trivial = trivial.filter(|t| t.is_trivial()).map(|t| {
        format!(
            "the fit calls {:.0} % of the total field the aircraft's, which is the trivial solution: take a larger `lambda`",
            100.0 * t.share
        )
    });
    let unused = (!unused.is_empty()).then(|| format!("too short for filter and trim, so not used: {unused}"));
    weak.into_iter().chain(trivial).chain(unused).collect::<Vec<_>>().join("; ")
}
