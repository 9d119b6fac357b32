//! `[search]`: axes whose values are searched rather than listed.
//!
//! A trial has one value of each searched axis. These axes together thus form one side of the sweep's grid. The tables
//! have the column `trial` and a column for each of these axes. The trials of `random` and `sobol` are known
//! beforehand; the trials of `tpe` and the rungs of `halving` depend on earlier scores. A
//! [`SearchState`](super::SearchState) gives the next trials.

use learning::search::{MOST_DIMENSIONS, ProposalMethod, SearchDimension, TrialValue};
use schemas::{ChoiceRegistry, Fault, Literal, ParamDoc, ParamReader, Params, Rule, SpecSection, choice, params};
use toml::{
    Spanned,
    de::{DeTable, DeValue},
};

use super::{SpecSpan, SweepAxis, axis};

/// The column of a trial's number.
pub const TRIAL: &str = "trial";
/// Maximum number of trials; more are probably a mistake.
const MOST_TRIALS: f64 = 100_000.0;
/// Largest number up to which every whole number is exact as a 64-bit float.
const MOST_WHOLE: f64 = (1_u64 << 53) as f64;
/// Keys that are parsed separately.
const OWN_KEYS: [&str; 3] = ["axes", "where", "halving"];
/// The columns of the table of trials that an axis must not hide.
const TAKEN: [&str; 7] = [TRIAL, "generation", "rung", "goal", "state", "error", "lines"];

choice! {
    /// The method that proposes trials.
    pub enum SearchMethodName {
        /// Uniformly at random.
        Random = "random",
        /// Sobol sequence, which fills the space more evenly.
        Sobol = "sobol",
        /// Tree-structured Parzen estimator, which prefers regions with a high density of good trials.
        Tpe = "tpe",
    }
}

choice! {
    /// The direction of improvement of the goal.
    pub enum GoalDirection {
        /// Smaller values are better.
        Minimise = "minimise",
        /// Larger values are better.
        Maximise = "maximise",
    }
}

params! {
    /// The table `[search]` of a spec.
    pub struct SearchKeys;
    /// The method that proposes trials.
    method: SearchMethodName, unit "", default SearchMethodName::Tpe;
    /// The number of trials.
    trials: usize, unit "", rule Rule::Between(1.0, MOST_TRIALS);
    /// The objective: a table of scores and one of its metrics, such as `scores.std_error`. The values of the lines are
    /// pooled as in the summary of a run, over all points of the remaining axes.
    goal: String, unit "";
    /// The direction of improvement of the goal.
    direction: Option<GoalDirection>, unit "", default None, absent "the direction of the metric";
    /// The seed of all random draws.
    seed: Option<usize>, unit "", default None, absent "the spec's seed";
    /// For `tpe`: the number of trials that are proposed together, before any of their scores is available.
    generation: Option<usize>, unit "", default None, absent "8", rule Rule::Between(1.0, MOST_TRIALS);
    /// For `tpe`: the number of initial trials from a Sobol sequence.
    start: Option<usize>, unit "", default None, absent "10", rule Rule::Between(1.0, MOST_TRIALS);
    /// For `sobol`: whether the seed scrambles the sequence. An unscrambled sequence begins at the lower ends of all
    /// axes.
    scramble: Option<bool>, unit "", default None, absent "true";
}

params! {
    /// The values of a searched axis.
    struct SearchAxisKeys;
    /// The lower end.
    low: f64, unit "", rule Rule::Finite;
    /// The upper end.
    high: f64, unit "", rule Rule::Finite;
    /// Whether the axis is logarithmic.
    log: bool, unit "", default false;
    /// Whether the values are whole numbers, both ends included.
    whole: bool, unit "", default false;
}

params! {
    /// Successive halving.
    struct HalvingKeys;
    /// The axis that sets the cost of a trial, such as the number of training epochs. It is an additional column of the
    /// trials.
    axis: String, unit "";
    /// The reduction factor: one of `eta` trials is promoted to the next rung.
    eta: usize, unit "", default 3usize, rule Rule::Between(2.0, 1000.0);
}

/// A checked `[search]`.
#[derive(Clone, Debug)]
pub struct SearchSpec {
    /// Position.
    pub at: SpecSpan,
    /// The method that proposes trials.
    pub method: ProposalMethod,
    /// Name of the method.
    pub named: SearchMethodName,
    /// The number of trials.
    pub trials: usize,
    /// Number of trials that are proposed together.
    pub generation: usize,
    /// The seed of all random draws.
    pub seed: u64,
    /// The table of scores that contains the goal.
    pub table: String,
    /// The metric.
    pub metric: String,
    /// Position of the goal.
    pub goal_at: SpecSpan,
    /// Direction of improvement of the goal; `None` for the metric's own direction.
    pub direction: Option<GoalDirection>,
    /// Condition on the lines of the goal, with position; `None` for all lines.
    pub predicate: Option<(String, SpecSpan)>,
    /// Successive halving.
    pub halving: Option<SuccessiveHalving>,
    /// The axes.
    pub axes: Vec<SearchAxis>,
}

/// Successive halving: a rung for each value of an axis.
#[derive(Clone, Debug)]
pub struct SuccessiveHalving {
    /// The axis.
    pub axis: String,
    /// Position.
    pub at: SpecSpan,
    /// Values, the cheapest first.
    pub values: Vec<Literal>,
    /// The reduction factor: one of `eta` trials is promoted to the next rung.
    pub eta: usize,
}

/// An axis of a search.
#[derive(Clone, Debug)]
pub struct SearchAxis {
    /// Name of the axis, which is also the name of its column.
    pub name: String,
    /// Position.
    pub at: SpecSpan,
    /// Values.
    pub dimension: SearchDimension,
    /// List of values to choose from.
    pub choices: Vec<Literal>,
}

impl SearchAxis {
    /// A value as stored in its column.
    pub fn literal(&self, value: TrialValue) -> Option<Literal> {
        match value {
            TrialValue::Real(x) => Some(Literal::Float(x)),
            TrialValue::Whole(n) => Some(Literal::Int(n)),
            TrialValue::Choice(i) => self.choices.get(i).cloned(),
        }
    }

    /// Values in words.
    pub fn words(&self) -> String {
        match self.dimension {
            SearchDimension::Real { low, high, log } => {
                format!("{low} to {high}{}", if log { ", by ratio" } else { "" })
            }
            SearchDimension::Whole { low, high, log } => {
                format!("{low} to {high}, whole{}", if log { ", by ratio" } else { "" })
            }
            SearchDimension::Choice(_) => self.choices.iter().map(Literal::to_string).collect::<Vec<_>>().join(" | "),
        }
    }
}

impl SearchSpec {
    /// The number of rungs; 1 without halving.
    pub fn rungs(&self) -> usize {
        self.halving.as_ref().map_or(1, |h| h.values.len())
    }

    /// Maximum number of rows of the table of trials: one for each trial at each of its rungs.
    pub fn most_rows(&self) -> usize {
        let eta = self.halving.as_ref().map_or(1, |h| h.eta.max(1));
        let of = |generation: usize| -> usize {
            let next = |n: &usize| Some((n / eta).max(1));
            std::iter::successors(Some(generation), next).take(self.rungs()).sum()
        };
        let size = self.generation.max(1);
        let last = self.trials % size;
        (self.trials / size).saturating_mul(of(size)) + if last > 0 { of(last) } else { 0 }
    }

    /// Names of its columns with their positions in the spec: the trial, the cost axis of the rungs, and the axes.
    pub fn columns(&self) -> Vec<(&str, &SpecSpan)> {
        let rung = self.halving.iter().map(|h| (h.axis.as_str(), &h.at));
        let axes = self.axes.iter().map(|a| (a.name.as_str(), &a.at));
        std::iter::once((TRIAL, &self.at)).chain(rung).chain(axes).collect()
    }
}

/// The keys of `[search]`.
pub struct SearchDocs {
    /// Keys of `[search]`, without `axes`, `where` and `halving`.
    pub search: Vec<ParamDoc>,
    /// Keys of an axis with two ends.
    pub axis: Vec<ParamDoc>,
    /// Keys of `halving`, without `values`.
    pub halving: Vec<ParamDoc>,
}

/// The declared keys of `[search]`.
pub fn docs() -> SearchDocs {
    let lists = ChoiceRegistry::default();
    SearchDocs {
        search: SearchKeys::docs(&lists),
        axis: SearchAxisKeys::docs(&lists),
        halving: HalvingKeys::docs(&lists),
    }
}

/// Every key of `[search]`, in Markdown.
pub fn reference() -> String {
    let SearchDocs { search, axis, halving } = docs();
    let mut text = "# A search\n\nA search proposes the values of the axes in `[search.axes]`. A trial has one value \
                    for each axis. Stages use these axes like listed ones: `\"$lambda\"`. Every table that depends on \
                    a searched axis has the column `trial` and one column for each axis. The table `trials` has the \
                    goal of each trial. An axis is a list of choices or a table with two ends. `where` in `[search]` \
                    is an SQL predicate on `flight` and `line` that selects the lines of the goal. `values` of \
                    `halving` are the values of its axis, the cheapest first. Every trial of a generation is run with \
                    the first value. The best 1/`eta` of the trials are then run with the next value.\n"
        .to_owned();
    let groups =
        [("[search]", search), ("[search.axes] NAME = { ... }", axis), ("[search] halving = { ... }", halving)];
    for (title, docs) in groups {
        text += &format!("\n`{title}`\n\n| key | type | unit | default | values | |\n|---|---|---|---|---|---|\n");
        text.extend(docs.iter().map(|d| d.row("")));
    }
    text
}

/// Reads `[search]` of a spec whose seed is `seed` and whose listed axes are `listed`.
///
/// # Errors
/// Fails with all faults, each with its position.
pub fn read(value: &Spanned<DeValue>, seed: u64, listed: &[SweepAxis]) -> Result<SearchSpec, Vec<Fault>> {
    let Some(table) = value.get_ref().as_table() else {
        return Err(vec![Fault::new("`search` must be a table: `[search]`").at(value.span())]);
    };
    let mut section = SpecSection::from_table(table, value.span())?;
    let predicate = section.keys.remove("where");
    OWN_KEYS.iter().for_each(|key| drop(section.keys.remove(*key)));
    let lists = ChoiceRegistry::default();
    let mut reader = ParamReader::new("search", &section.keys, Some(value.span()), &lists);
    let keys = SearchKeys::read(&mut reader, None);
    let known: Vec<&str> = SearchKeys::docs(&lists).iter().map(|doc| doc.name).collect();
    reader.unknown_keys(&known, &OWN_KEYS);
    let mut faults = reader.into_faults();
    let at = |key: &str| section.keys.get(key).map_or(value.span(), |given| given.at.clone());
    let predicate = predicate.and_then(|given| match given.value.as_text() {
        Some(text) => Some((text.to_owned(), given.at.clone())),
        None => {
            faults.push(Fault::new("`where` must be text").at(given.at.clone()));
            None
        }
    });
    let halving = table.get("halving").and_then(|v| halving(v).map_err(|f| faults.extend(f)).ok());
    let axes = axes(table, value.span()).map_err(|f| faults.extend(f)).unwrap_or_default();
    let goal = keys.as_ref().and_then(|k| match k.goal.split_once('.') {
        Some((table, metric)) if !table.is_empty() && !metric.is_empty() => Some((table.to_owned(), metric.to_owned())),
        _ => {
            let fault = Fault::new(format!("`goal` cannot be `{}`", k.goal)).at(at("goal"));
            faults.push(fault.help("give a table of scores and a metric, such as `scores.std_error`"));
            None
        }
    });
    let method = keys.as_ref().map(|k| {
        let mut foreign = |key: &str, given: bool, owner: SearchMethodName| {
            if given && k.method != owner {
                let what = format!("`{key}` belongs to `{}`, not to `{}`", owner.word(), k.method.word());
                faults.push(Fault::new(what).at(at(key)).help("remove the key"));
            }
        };
        foreign("generation", k.generation.is_some(), SearchMethodName::Tpe);
        foreign("start", k.start.is_some(), SearchMethodName::Tpe);
        foreign("scramble", k.scramble.is_some(), SearchMethodName::Sobol);
        match k.method {
            SearchMethodName::Random => ProposalMethod::Random,
            SearchMethodName::Sobol => ProposalMethod::Sobol { scramble: k.scramble.unwrap_or(true) },
            SearchMethodName::Tpe => ProposalMethod::Tpe { start: k.start.unwrap_or(10) },
        }
    });
    if axes.len() > MOST_DIMENSIONS && !matches!(method, Some(ProposalMethod::Random)) {
        let what =
            format!("{} axes are searched, but the Sobol sequence supports at most {MOST_DIMENSIONS}", axes.len());
        faults.push(Fault::new(what).at(value.span()).help("search fewer axes, or set `method = \"random\"`"));
    }
    let (Some(keys), Some(method), Some((goal_table, metric))) = (keys, method, goal) else { return Err(faults) };
    let generation = match keys.method {
        SearchMethodName::Random | SearchMethodName::Sobol => keys.trials,
        SearchMethodName::Tpe => keys.generation.unwrap_or(8).min(keys.trials),
    };
    let search = SearchSpec {
        at: value.span(),
        method,
        named: keys.method,
        trials: keys.trials,
        generation,
        seed: keys.seed.map_or(seed, |s| s as u64),
        table: goal_table,
        metric,
        goal_at: at("goal"),
        direction: keys.direction,
        predicate,
        halving,
        axes,
    };
    faults.extend(clashes(&search, listed));
    if faults.is_empty() { Ok(search) } else { Err(faults) }
}

/// Faults of axes with duplicate names, and of axes that are both searched and listed.
fn clashes(search: &SearchSpec, listed: &[SweepAxis]) -> Vec<Fault> {
    let mut faults = vec![];
    let mut push = |what: String, at: &SpecSpan, help: &str| faults.push(Fault::new(what).at(at.clone()).help(help));
    if let Some(axis) = listed.iter().find(|a| a.name == TRIAL) {
        let what = format!("the axis `{TRIAL}` has the same name as the column of trials");
        push(what, &axis.at, "rename the axis");
    }
    for (name, at) in search.columns().into_iter().skip(1) {
        if listed.iter().any(|a| a.name == name) {
            push(format!("the axis `{name}` is both searched and listed in `[axes]`"), at, "remove one of them");
        }
        if TAKEN.contains(&name) {
            let what = format!("the axis `{name}` has the same name as a column of the table of trials");
            push(what, at, "rename the axis");
        }
    }
    if let Some(h) = search.halving.as_ref().filter(|h| search.axes.iter().any(|a| a.name == h.axis)) {
        let what = format!("the axis `{}` of `halving` is also searched", h.axis);
        push(what, &h.at, "remove the axis from `[search.axes]`; the rungs of `halving` are its values");
    }
    faults
}

/// `halving = { axis = "epochs", values = [10, 30, 90], eta = 3 }`.
fn halving(value: &Spanned<DeValue>) -> Result<SuccessiveHalving, Vec<Fault>> {
    let Some(table) = value.get_ref().as_table() else {
        let fault = Fault::new("`halving` must be a table").at(value.span());
        return Err(vec![
            fault.help("write for example `halving = { axis = \"epochs\", values = [10, 30, 90], eta = 3 }`"),
        ]);
    };
    let mut section = SpecSection::from_table(table, value.span())?;
    section.keys.remove("values");
    let lists = ChoiceRegistry::default();
    let mut reader = ParamReader::new("halving", &section.keys, Some(value.span()), &lists);
    let keys = HalvingKeys::read(&mut reader, None);
    reader.unknown_keys(&["axis", "eta"], &["values"]);
    let mut faults = reader.into_faults();
    let at = section.keys.get("axis").map_or(value.span(), |given| given.at.clone());
    let name = keys.as_ref().map_or("halving", |k| k.axis.as_str());
    let values = match table.get("values") {
        Some(values) => axis::values(name, values).map_err(|f| faults.extend(f)).unwrap_or_default(),
        None => {
            let fault = Fault::new("`halving` requires `values`: the values of its axis, the cheapest first");
            faults.push(fault.at(value.span()));
            vec![]
        }
    };
    if values.len() == 1 {
        let fault = Fault::new("`halving` requires at least two rungs").at(value.span());
        faults.push(fault.help("give at least two `values`, the cheapest first"));
    }
    match keys {
        Some(keys) if faults.is_empty() => Ok(SuccessiveHalving { axis: keys.axis, at, values, eta: keys.eta }),
        _ => Err(faults),
    }
}

fn axes(table: &DeTable, at: SpecSpan) -> Result<Vec<SearchAxis>, Vec<Fault>> {
    let missing = || {
        Fault::new("`search` requires `[search.axes]`, the searched axes")
            .help("write for example `lambda = { low = 1e-4, high = 1.0, log = true }`")
    };
    let Some(value) = table.get("axes") else { return Err(vec![missing().at(at)]) };
    let Some(axes) = value.get_ref().as_table().filter(|t| !t.is_empty()) else {
        return Err(vec![missing().at(value.span())]);
    };
    let mut entries: Vec<_> = axes.iter().collect();
    entries.sort_by_key(|(key, _)| key.span().start);
    let (mut found, mut faults) = (vec![], vec![]);
    for (key, value) in entries {
        match searched(key.get_ref(), key.span(), value) {
            Ok(axis) => found.push(axis),
            Err(more) => faults.extend(more),
        }
    }
    if faults.is_empty() { Ok(found) } else { Err(faults) }
}

/// Reads a searched axis: a list of choices, or a table of two ends.
fn searched(name: &str, at: SpecSpan, value: &Spanned<DeValue>) -> Result<SearchAxis, Vec<Fault>> {
    let Some(table) = value.get_ref().as_table().filter(|t| !t.contains_key("subsets_of")) else {
        let choices = axis::values(name, value)?;
        return Ok(SearchAxis {
            name: name.to_owned(),
            at,
            dimension: SearchDimension::Choice(choices.len()),
            choices,
        });
    };
    let section = SpecSection::from_table(table, value.span())?;
    let lists = ChoiceRegistry::default();
    let owner = format!("search.axes.{name}");
    let (ends, mut faults) =
        ParamReader::new(&owner, &section.keys, Some(value.span()), &lists).group::<SearchAxisKeys>(None);
    let Some(SearchAxisKeys { low, high, log, whole }) = ends else { return Err(faults) };
    let place = |key: &str| section.keys.get(key).map_or(value.span(), |given| given.at.clone());
    if low >= high {
        faults.push(
            Fault::new(format!("`low` of the axis `{name}` is {low}; it must be below `high`, {high}"))
                .at(place("low")),
        );
    }
    if log && low <= 0.0 {
        let fault =
            Fault::new(format!("`low` of the axis `{name}` is {low}; with `log` it must be positive")).at(place("low"));
        faults.push(fault.help("increase `low` above 0, or remove `log`"));
    }
    for (key, end) in [("low", low), ("high", high)] {
        if whole && (end.fract() != 0.0 || end.abs() >= MOST_WHOLE) {
            faults.push(
                Fault::new(format!("`{key}` of the axis `{name}` is {end}; it must be a whole number")).at(place(key)),
            );
        }
    }
    if !(high - low).is_finite() {
        faults.push(Fault::new(format!("the range of the axis `{name}` is too large")).at(value.span()));
    }
    if !faults.is_empty() {
        return Err(faults);
    }
    let dimension = match whole {
        true => SearchDimension::Whole { low: low as i64, high: high as i64, log },
        false => SearchDimension::Real { low, high, log },
    };
    Ok(SearchAxis { name: name.to_owned(), at, dimension, choices: vec![] })
}
