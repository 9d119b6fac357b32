//! Models of a sweep, computed from the moments of the lines.

use std::{borrow::Cow, collections::BTreeMap, sync::Arc};

use numerics::{
    compensation::diagnostics::{Excitation, TrivialSolution, approximation_bound_nt, excitation, trivial_solution},
    regression::{
        cross_spectra::CrossSpectra,
        least_squares::{LeastSquaresError, LinearFit, RegressionMoments, RidgePath, ScaledFactor},
    },
};
use schemas::Fault;

use super::{
    components::FitComponents,
    question::{DesignMatrixKey, TargetColumns},
    rows::{FitLineSummary, FitRows, LineContribution, TermRate},
    samples::{FitSamples, LineSamples},
    settings::{FitSettings, ModelSelection},
};
use crate::columns::data;

/// Directions are listed if their excitation is below this fraction of the strongest excitation.
const WEAK: f64 = 1e-4;

/// Range of the total field on earth, in nT.
const TOTAL_NT: std::ops::Range<f64> = 20_000.0..80_000.0;

/// Contributions of all lines to the fits of one target to one matrix.
#[derive(Clone)]
pub struct FitProblem<'a> {
    shares: Vec<&'a LineContribution>,
    /// Names of the matrix columns and, for the contribution of each line, the rate dependence of each term.
    all_terms: &'a [String],
    rates: Vec<&'a [TermRate]>,
    /// Factors that convert the terms of each contribution to `rate_hz`. `None` if all are 1.
    factors: Vec<Option<Vec<f64>>>,
    /// Sample rate of the terms that are differences per sample, in Hz: the rate of the first line.
    pub(super) rate_hz: f64,
    /// Flight of each contribution.
    flights: Vec<String>,
    /// Used lines, and each unused line with the reason.
    pub(super) lines: Vec<String>,
    pub(super) unused: String,
    /// Matrix columns used. `None` selects all.
    places: Option<Vec<usize>>,
    /// Moments of all lines together.
    pub merged: RegressionMoments,
    /// Moments of some unfiltered rows of all lines.
    unfiltered: Option<RegressionMoments>,
    /// Names of the columns.
    pub terms: Vec<String>,
    /// Number of rows of the selected lines.
    pub(super) selected: usize,
    prepared: BTreeMap<(u8, bool), (Arc<ScaledFactor>, Arc<Excitation>)>,
    paths: BTreeMap<(u8, bool), Arc<RidgePath>>,
    /// Components that replace the features, and the names of the features.
    pub(super) components: Option<FitComponents>,
}

impl<'a> FitProblem<'a> {
    /// Gathers the contributions of the lines, in the order of the lines.
    ///
    /// # Errors
    /// Fails if no selected line has the features, no row remains after filter and trim, or the lines have different
    /// numbers of terms.
    pub fn new(parts: &[&'a FitLineSummary], at: &(DesignMatrixKey, TargetColumns)) -> Result<Self, Fault> {
        let terms = parts.iter().find_map(|p| p.terms.get(&at.0));
        let terms = terms.ok_or_else(|| Fault::data("no selected line has all features of the fit"))?;
        let rates = |part: &'a FitLineSummary| part.rates.get(&at.0).map(Vec::as_slice).unwrap_or_default();
        let all: Vec<(&'a FitLineSummary, &'a LineContribution)> =
            parts.iter().filter_map(|p| p.shares.get(at).map(|s| (*p, s))).collect();
        let selected = all.iter().map(|(_, s)| s.selected).sum();
        let (used, unused): (Vec<_>, Vec<_>) = all.into_iter().partition(|(_, s)| s.moments.rows() > 0);
        let unused = too_short(&unused);
        if used.is_empty() {
            let what = format!(
                "no run of samples with `{}` and all features is long enough to be filtered and trimmed: {unused}",
                at.1.join("`, `")
            );
            return Err(Fault::data(what).help("select longer lines, or reduce `trim` or `order`"));
        }
        let lines: Vec<String> = used.iter().map(|(p, _)| format!("{}/{}", p.flight, p.line)).collect();
        let (rate_hz, rates) = (used[0].0.rate_hz, used.iter().map(|(p, _)| rates(p)).collect());
        let (flights, shares): (Vec<String>, Vec<&LineContribution>) =
            used.into_iter().map(|(p, s)| (p.flight.clone(), s)).unzip();
        let (merged, unfiltered) = (shares[0].moments.clone(), None);
        let (prepared, paths) = (BTreeMap::new(), BTreeMap::new());
        let problem = Self {
            shares,
            all_terms: terms,
            rates,
            factors: vec![],
            rate_hz,
            flights,
            lines,
            unused,
            places: None,
            merged,
            unfiltered,
            terms: terms.clone(),
            selected,
            prepared,
            paths,
            components: None,
        };
        problem.at_rate(rate_hz)
    }

    /// The same problem with all difference terms converted to another rate.
    ///
    /// # Errors
    /// Fails if a term has no equivalent at that rate, or the lines have different numbers of terms.
    pub fn at_rate(&self, rate_hz: f64) -> Result<Self, Fault> {
        let mut problem = self.clone();
        (problem.rate_hz, problem.factors) = (rate_hz, vec![]);
        for rates in &self.rates {
            let own = rates.iter().zip(self.all_terms).map(|(rate, term)| factor(*rate, term, rate_hz));
            let own = own.collect::<Result<Vec<f64>, Fault>>()?;
            problem.factors.push(Some(own).filter(|own| own.iter().any(|x| *x != 1.0)));
        }
        problem.prepared.clear();
        problem.paths.clear();
        problem.merge()?;
        Ok(problem)
    }

    /// Returns whether one of these terms depends on the sample rate.
    pub fn depends_on_rate(&self, terms: &[String]) -> bool {
        let rated = |rates: &&[TermRate]| {
            rates.iter().zip(self.all_terms).any(|(rate, term)| rate.is_some() && terms.contains(term))
        };
        self.rates.iter().any(rated)
    }

    /// Merges the moments of all lines.
    fn merge(&mut self) -> Result<(), Fault> {
        let own = |moments: &RegressionMoments, share: usize| {
            let scaled = self.scaled(moments, share)?;
            own(&scaled, self.places.as_deref())
        };
        let each = self.shares.iter().enumerate();
        let moments = each.clone().map(|(i, s)| own(&s.moments, i)).collect::<Result<Vec<_>, Fault>>()?;
        let unfiltered = each.filter_map(|(i, s)| Some(own(s.unfiltered.as_ref()?, i)));
        let unfiltered = RegressionMoments::merged(&unfiltered.collect::<Result<Vec<_>, Fault>>()?).ok();
        (self.merged, self.unfiltered) = (RegressionMoments::merged(&moments).map_err(data)?, unfiltered);
        Ok(())
    }

    /// Moments of a contribution at the rate of the problem.
    fn scaled<'m>(&self, moments: &'m RegressionMoments, share: usize) -> Result<Cow<'m, RegressionMoments>, Fault> {
        match self.factors.get(share) {
            Some(Some(factors)) => moments.scaled(factors).map(Cow::Owned).map_err(data),
            Some(None) | None => Ok(Cow::Borrowed(moments)),
        }
    }

    /// Cross-spectra of all lines, the target last. `None` if cross-spectra were not requested.
    pub fn spectra(&self) -> Option<CrossSpectra> {
        if self.components.is_some() {
            return None;
        }
        let mut all: Option<CrossSpectra> = None;
        for (share, factors) in self.shares.iter().zip(&self.factors) {
            let spectra = share.spectra.as_ref()?;
            let width = share.moments.terms();
            let factor = |i: usize| factors.as_ref().and_then(|f| f.get(i)).copied().unwrap_or(1.0);
            let places = self.places.clone().unwrap_or_else(|| (0..width).collect());
            let own: Vec<(usize, f64)> = places.into_iter().map(|i| (i, factor(i))).chain([(width, 1.0)]).collect();
            let own = spectra.select(&own);
            match &mut all {
                Some(all) => all.merge(&own),
                None => all = Some(own),
            }
        }
        all
    }

    /// Groups that cross-validation omits in turn: the lines, or the flights with all their lines.
    ///
    /// # Errors
    /// Fails if a line has another number of features than the problem.
    pub fn groups(&self, settings: &FitSettings) -> Result<Vec<RegressionMoments>, Fault> {
        let lines = self.lines()?;
        if settings.choose != ModelSelection::LeaveOneFlightOut {
            return Ok(lines);
        }
        let mut flights: Vec<(&String, Vec<RegressionMoments>)> = vec![];
        for (flight, line) in self.flights.iter().zip(lines) {
            match flights.iter_mut().find(|(f, _)| *f == flight) {
                Some((_, lines)) => lines.push(line),
                None => flights.push((flight, vec![line])),
            }
        }
        flights.iter().map(|(_, lines)| RegressionMoments::merged(lines).map_err(data)).collect()
    }

    /// The same problem with only the terms at `places` (or all terms), computed from the factor of all terms.
    ///
    /// # Errors
    /// Fails if a position is beyond the last term.
    pub fn cut(&self, places: Option<Vec<usize>>) -> Result<FitProblem<'a>, Fault> {
        let own = |moments: &RegressionMoments| own(moments, places.as_deref());
        let (merged, unfiltered) = (own(&self.merged)?, self.unfiltered.as_ref().map(own).transpose()?);
        let terms = match &places {
            Some(places) => places.iter().filter_map(|&i| self.terms.get(i).cloned()).collect(),
            None => self.terms.clone(),
        };
        Ok(FitProblem {
            shares: self.shares.clone(),
            all_terms: self.all_terms,
            rates: self.rates.clone(),
            factors: self.factors.clone(),
            rate_hz: self.rate_hz,
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

    /// The same problem with whitened principal components of the standardised features instead of the features. `keep`
    /// is the number of components; a value below 1 is the fraction of the variance that they explain. Without `keep`,
    /// the problem is returned unchanged.
    ///
    /// # Errors
    /// Fails if there are no rows, no component is kept, or the decomposition does not converge.
    pub fn whitened(mut self, keep: Option<f64>) -> Result<Self, Fault> {
        let Some(keep) = keep else { return Ok(self) };
        let components = FitComponents::whitened(&self.merged, std::mem::take(&mut self.terms), keep)?;
        self.terms = components.names();
        self.merged = components.component_moments(&self.merged)?;
        // Results from the unfiltered terms refer to the features and not to the components.
        self.unfiltered = None;
        self.components = Some(components);
        Ok(self)
    }

    /// Moments of each line.
    fn lines(&self) -> Result<Vec<RegressionMoments>, Fault> {
        let own = |(i, s): (usize, &&LineContribution)| {
            let own = own(&*self.scaled(&s.moments, i)?, self.places.as_deref())?;
            match &self.components {
                Some(components) => components.component_moments(&own),
                None => Ok(own),
            }
        };
        self.shares.iter().enumerate().map(own).collect()
    }

    /// Rows of each line: terms row-major, and the target.
    pub fn rows(&self) -> Vec<(Cow<'a, [f64]>, &'a [f64])> {
        let own = |(share, factors): (&&'a LineContribution, &Option<Vec<f64>>)| {
            let FitRows { a, y, .. } = share.rows.as_ref()?;
            let width = (a.len() / y.len().max(1)).max(1);
            let a: Cow<'a, [f64]> = match factors {
                Some(factors) => Cow::Owned(a.iter().zip(factors.iter().cycle()).map(|(x, f)| x * f).collect()),
                None => Cow::Borrowed(a.as_slice()),
            };
            let a = match &self.places {
                Some(places) => {
                    let row = |row: &[f64]| places.iter().map(|&i| row[i]).collect::<Vec<_>>();
                    Cow::Owned(a.chunks_exact(width).flat_map(row).collect())
                }
                None => a,
            };
            Some((a, y.as_slice()))
        };
        self.shares.iter().zip(&self.factors).filter_map(own).collect()
    }

    /// Rows of each line with the names of line and flight, for models that learn from samples.
    pub fn samples(&self) -> FitSamples<'_> {
        let lines = self.rows().into_iter().zip(&self.shares).zip(&self.lines).zip(&self.flights);
        let one = |(((rows, share), name), flight): (((_, &&'a LineContribution), &'_ String), &'_ String)| {
            let (x, y): (Cow<'a, [f64]>, &'a [f64]) = rows;
            let own = share.rows.as_ref()?;
            let (flight, name) = (flight.clone(), name.clone());
            Some(LineSamples { flight, name, x, y, runs: &own.runs, rate_hz: own.rate_hz })
        };
        FitSamples { names: &self.terms, lines: lines.filter_map(one).collect() }
    }

    /// Scaled columns, and the directions that the flight excites.
    pub(super) fn prepared(&mut self, settings: &FitSettings) -> Result<(Arc<ScaledFactor>, Arc<Excitation>), Fault> {
        let (scaling, intercept) = (settings.scaling, settings.intercept);
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

    /// Computes the ridge solutions of all points with these settings in one pass. `lambdas` are the ridge parameters
    /// of the sweep.
    ///
    /// # Errors
    /// Fails if the decomposition does not converge.
    pub fn solve_ridges(&mut self, settings: &FitSettings, lambdas: &[f64]) -> Result<(), Fault> {
        let (prepared, _) = self.prepared(settings)?;
        // If one parameter has no solution, such as 0 with unexcited terms, each parameter is solved separately later.
        if let Ok(path) = prepared.ridge(lambdas, &self.terms) {
            self.paths.insert((settings.scaling as u8, settings.intercept), Arc::new(path));
        }
        Ok(())
    }

    /// Solutions of [`FitProblem::solve_ridges`] for these settings.
    pub fn path(&self, settings: &FitSettings) -> Option<&Arc<RidgePath>> {
        self.paths.get(&(settings.scaling as u8, settings.intercept))
    }

    /// Degrees of freedom of the residual variance.
    pub fn free(&self, parameters: usize, settings: &FitSettings) -> f64 {
        self.merged.rows() as f64 - parameters as f64 - f64::from(u8::from(settings.intercept))
    }

    /// Total field and scale of the induced terms, from unfiltered rows. The induced terms add up to the field divided
    /// by the scale of the terms. `None` if the target is not a total field, or the induced terms are missing.
    fn field(&self) -> Option<(f64, f64)> {
        // Without a filter the rows themselves are unfiltered.
        let unfiltered = self.unfiltered.as_ref().unwrap_or(&self.merged);
        let means = unfiltered.term_means();
        let mean = |name: &str| means.get(self.terms.iter().position(|t| t == name)?).copied();
        let total_nt = unfiltered.target_means().first().copied()?;
        let scale_nt = total_nt / (mean("xx")? + mean("yy")? + mean("zz")?);
        (scale_nt.is_finite() && TOTAL_NT.contains(&total_nt)).then_some((total_nt, scale_nt))
    }

    /// Upper bound on the error of the linear form of a model. NaN if its terms do not determine it.
    pub(super) fn approximation_bound_nt(&self, fit: &LinearFit) -> f64 {
        let Some((field_nt, scale_nt)) = self.field() else { return f64::NAN };
        let value = |name: &str| {
            let at = self.terms.iter().position(|t| t == name);
            at.and_then(|at| fit.coefficients.get(at)).copied().unwrap_or(0.0)
        };
        let permanent_nt = ["x", "y", "z"].map(value);
        let induced = ["xx", "xy", "xz", "yy", "yz", "zz"].map(|name| value(name) / scale_nt);
        approximation_bound_nt(permanent_nt, induced, field_nt)
    }

    /// Fraction of the total field that a fit with this `lambda` attributes to the aircraft. `None` if its terms do not
    /// determine it.
    pub(super) fn trivial(&self, fit: &LinearFit, lambda: f64) -> Result<Option<TrivialSolution>, Fault> {
        let Some(unfiltered) = &self.unfiltered else { return Ok(None) };
        let Some((_, scale_nt)) = self.field() else { return Ok(None) };
        trivial_solution(unfiltered, &self.merged, 0, &self.terms, fit, lambda, scale_nt).map_err(data)
    }
}

/// Factor that converts a term to another rate.
pub fn factor(rate: TermRate, term: &str, to_hz: f64) -> Result<f64, Fault> {
    let Some((law, from_hz)) = rate else { return Ok(1.0) };
    law.factor(from_hz, to_hz).ok_or_else(|| {
        let what = format!(
            "`{term}` is the value of an earlier sample, but the lines are sampled at {from_hz} Hz and {to_hz} Hz"
        );
        Fault::data(what).help("add a `resample` stage before `features`, so that all lines have one rate")
    })
}

/// Moments of the columns at `places`, or of all columns if `None`.
fn own(moments: &RegressionMoments, places: Option<&[usize]>) -> Result<RegressionMoments, Fault> {
    match places {
        Some(places) => moments.select(places, &(0..moments.targets()).collect::<Vec<_>>()).map_err(data),
        None => Ok(moments.clone()),
    }
}

/// Fault of a failed cross-validation.
pub fn lines_needed(error: LeastSquaresError) -> Fault {
    data(error).help(
        "cross-validation requires at least two lines, or flights; select more lines with `where`, or change `choose`",
    )
}

/// Maximum number of lines listed by name.
const NAMED: usize = 5;

/// Selected lines that are not used, and the reasons. Empty if there are none.
fn too_short(lines: &[(&FitLineSummary, &LineContribution)]) -> String {
    let lines: Vec<&(&FitLineSummary, &LineContribution)> = lines.iter().filter(|(_, s)| s.selected > 0).collect();
    let one = |(part, share): &&(&FitLineSummary, &LineContribution)| {
        let (has, least) = share.longest;
        format!("flight {}, line {} has {has} samples in its longest run and requires {least}", part.flight, part.line)
    };
    let mut named: Vec<String> = lines.iter().take(NAMED).map(one).collect();
    let more = lines.len().saturating_sub(NAMED);
    if more > 0 {
        named.push(format!("and {more} more"));
    }
    named.join("; ")
}
