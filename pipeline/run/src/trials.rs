//! Goals of the trials of a search, from the scores in the store, and the next trials, which follow from the goals.

use arrow_array::{
    Array,
    cast::AsArray,
    types::{Float64Type, Int64Type},
};
use arrow_cast::cast;
use arrow_schema::DataType;
use plan::{
    LineId, Plan, PlanGraph, PlanUnit, SearchGoal, TableRef,
    sources::ReadProgress,
    spec::{SearchSpec, SearchState, SearchTrial, SearchTrialScore, SpecFaults},
};
use schemas::{Fault, Grain, StageEntry, metric::WeightedScore};
use stages::score::{SPREAD, spread_at};
use store::Store;

use super::Failure;

/// Callback for the progress of reading a source.
pub type SourceReadCallback<'a> = dyn Fn(&str, &ReadProgress) + Sync + 'a;

/// Stored state of a unit.
enum StoredUnitState {
    /// Stored rows.
    There,
    /// Failure caused by the data of the unit or of an input.
    Failed(Option<Box<Fault>>),
    /// Not computed yet.
    Unknown,
}

/// Goals of the trials `rows`, which must be the trials of the plan of `graph`. `None` if a score of a trial is not
/// computed yet; with `all`, the trial counts as failed instead.
///
/// A trial that lacks the scores of a line has no goal, because means over different lines are not comparable.
/// Unreadable lines are excluded from all trials.
///
/// # Errors
/// Fails if `where` selects no line, or the store cannot be read.
pub fn scored(
    graph: &PlanGraph,
    store: &Store,
    rows: &[SearchTrial],
    all: bool,
) -> Result<Option<Vec<SearchTrialScore>>, Fault> {
    let plan = graph.plan;
    let Some(goal) = plan.goal()? else { return Ok(None) };
    let mut of_row: Vec<Vec<usize>> = vec![vec![]; rows.len()];
    let searched = plan.spec.searched.start;
    for i in 0..plan.tables[goal.table].len() {
        let at = plan.tables[goal.table].grid().place(i).find(|(axis, _)| *axis == searched);
        if let Some(points) = at.and_then(|(_, at)| of_row.get_mut(at)) {
            points.push(i);
        }
    }
    let wanted = wanted(graph, &goal)?;
    let mut found = vec![];
    for (row, points) in rows.iter().zip(of_row) {
        let units = points.iter().flat_map(|i| graph.lines_of(goal.table, *i).iter().map(|l| (*i, *l)));
        let units = units.filter(|(_, line)| wanted.get(*line).copied().unwrap_or(false));
        let units: Vec<PlanUnit> =
            units.map(|(i, l)| PlanUnit { table: goal.table, instance: i, line: Some(l) }).collect();
        match one(graph, store, &goal, row, &units, all)? {
            Some(scored) => found.push(scored),
            None => return Ok(None),
        }
    }
    Ok(Some(found))
}

/// Checks that the goal of a search covers at least one line.
///
/// # Errors
/// Fails if the goal covers no line.
pub fn check(graph: &PlanGraph) -> Result<(), Fault> {
    graph.plan.goal()?.map_or(Ok(()), |goal| wanted(graph, &goal).map(drop))
}

/// Failure of a search in which no trial has a goal.
pub fn no_trial_succeeded(plan: &Plan, trials: &[SearchTrialScore]) -> Option<Failure> {
    let search = plan.spec.search.as_ref()?;
    let why = trials.first()?.error.clone().unwrap_or_default();
    let what =
        format!("the goal `{}.{}` has no value in any of the {} trials", search.table, search.metric, trials.len());
    trials.iter().all(|t| t.cost.is_none()).then(|| Failure {
        table: search.table.clone(),
        point: Default::default(),
        line: None,
        fault: Fault::data(format!("{what}; the reason in the first trial: {why}")),
    })
}

/// Whether each line counts: the line is selected by `where` and is readable.
fn wanted(graph: &PlanGraph, goal: &SearchGoal) -> Result<Vec<bool>, Fault> {
    let selected = match &goal.lines {
        Some(predicate) => predicate.lines(&graph.lines)?,
        None => vec![true; graph.lines.len()],
    };
    let readable = |line: LineId| graph.records.iter().all(|r| r.get(&line).is_none_or(|l| l.fault.is_none()));
    let wanted: Vec<bool> = selected.into_iter().enumerate().map(|(line, s)| s && readable(line)).collect();
    let of_goal = graph.all_lines_of(goal.table);
    if of_goal.iter().any(|l| wanted.get(*l).copied().unwrap_or(false)) {
        return Ok(wanted);
    }
    let name = |l: &LineId| graph.lines.get(*l).map(|(flight, line)| format!("{flight}/{line}"));
    let some: Vec<String> = of_goal.iter().take(12).filter_map(name).collect();
    let fault = Fault::new("the goal of the search selects no line");
    let at =
        graph.plan.spec.search.as_ref().map(|s| s.predicate.as_ref().map_or(s.goal_at.clone(), |(_, at)| at.clone()));
    let fault = at.into_iter().fold(fault, Fault::at);
    Err(fault.help(format!("lines of its table, as flight/line: {}", some.join(", "))))
}

fn one(
    graph: &PlanGraph,
    store: &Store,
    goal: &SearchGoal,
    row: &SearchTrial,
    units: &[PlanUnit],
    all: bool,
) -> Result<Option<SearchTrialScore>, Fault> {
    let mut pairs: Vec<(f64, f64, Vec<f64>)> = vec![];
    let mut error = None;
    for unit in units {
        match stored_state(graph, store, *unit)? {
            StoredUnitState::There => pairs.extend(values(graph, store, goal, *unit)?),
            StoredUnitState::Unknown if !all => return Ok(None),
            state @ (StoredUnitState::Failed(_) | StoredUnitState::Unknown) => {
                let why = match state {
                    StoredUnitState::Failed(Some(fault)) => fault.to_string(),
                    StoredUnitState::Failed(None) | StoredUnitState::Unknown | StoredUnitState::There => {
                        "it could not be computed".to_owned()
                    }
                };
                let line = unit.line.and_then(|l| graph.lines.get(l));
                let place = line.map(|(flight, line)| format!("flight {flight}, line {line}: ")).unwrap_or_default();
                error.get_or_insert(if why.starts_with(&place) { why } else { format!("{place}{why}") });
            }
        }
    }
    let weighed = pairs.iter().map(|(value, n, spread)| WeightedScore { value: *value, n: *n, spread });
    let pooled = Some(goal.metric.pool.value(weighed)).filter(|v| v.is_finite() && error.is_none());
    let cost = pooled.and_then(|v| goal.cost(v));
    if cost.is_none() {
        error.get_or_insert_with(|| format!("`{}` has no value on any line", goal.metric.name));
    }
    let goal = pooled.filter(|_| cost.is_some());
    Ok(Some(SearchTrialScore { row: row.clone(), goal, cost, lines: units.len(), error, promoted: false }))
}

/// Value of the metric, its weight and its spread, if available.
fn values(
    graph: &PlanGraph,
    store: &Store,
    goal: &SearchGoal,
    unit: PlanUnit,
) -> Result<Vec<(f64, f64, Vec<f64>)>, Fault> {
    let batch = store.get(graph.key(unit)?, &["metric", "value", "n", SPREAD])?;
    let lacking = || Fault::bug("a table of scores lacks `metric`, `value` or `n`");
    let column = |name: &str| batch.column_by_name(name).ok_or_else(lacking);
    let n = cast(column("n")?, &DataType::Int64).map_err(|_| lacking())?;
    let words = column("metric")?.as_string_opt::<i32>().ok_or_else(lacking)?;
    let values = column("value")?.as_primitive_opt::<Float64Type>().ok_or_else(lacking)?;
    let n = n.as_primitive_opt::<Int64Type>().ok_or_else(lacking)?;
    let of_goal = (0..batch.num_rows()).filter(|i| words.is_valid(*i) && words.value(*i) == goal.metric.name);
    let given = of_goal.filter(|i| values.is_valid(*i) && n.is_valid(*i));
    let spreads = batch.column_by_name(SPREAD).and_then(|a| a.as_list_opt::<i32>());
    Ok(given.map(|i| (values.value(i), n.value(i) as f64, spread_at(spreads, i))).collect())
}

/// Stored state of a unit. For a unit that is not in the store, the state follows from its inputs.
fn stored_state(graph: &PlanGraph, store: &Store, unit: PlanUnit) -> Result<StoredUnitState, Fault> {
    let key = match graph.key(unit) {
        Ok(key) => key,
        Err(fault) => return Ok(StoredUnitState::Failed(Some(Box::new(fault)))),
    };
    match store.find(key).map(|place| place.rows) {
        Some(Some(_)) => return Ok(StoredUnitState::There),
        Some(None) => return Ok(StoredUnitState::Failed(store.failed(key)?.map(Box::new))),
        None => {}
    }
    let it = graph.plan.instance(unit.table, unit.instance);
    let of_line = |r: TableRef, line: LineId| match r {
        TableRef::Flights(i) => {
            Ok(match graph.records.get(i).and_then(|r| r.get(&line)).and_then(|l| l.fault.clone()) {
                Some(fault) => StoredUnitState::Failed(Some(Box::new(fault))),
                None => StoredUnitState::There,
            })
        }
        TableRef::Stage(table, instance) => {
            let line = (graph.plan.tables[table].entry.grain == Grain::Line).then_some(line);
            stored_state(graph, store, PlanUnit { table, instance, line })
        }
        TableRef::Map(_) => Ok(StoredUnitState::There),
    };
    for (kind, r) in it.kinds().into_iter().zip(it.inputs()) {
        let found = match (kind.is_by_line(), unit.line) {
            _ if kind.is_record() => StoredUnitState::Unknown,
            (true, Some(line)) => of_line(r, line)?,
            (false, _) => match r {
                TableRef::Stage(table, instance) => {
                    stored_state(graph, store, PlanUnit { table, instance, line: None })?
                }
                TableRef::Map(_) | TableRef::Flights(_) => StoredUnitState::There,
            },
            (true, None) => {
                // A fit skips failed lines, unless all lines failed.
                let lines = graph.lines_of(unit.table, unit.instance);
                let mut states = lines.iter().map(|line| of_line(r, *line)).collect::<Result<Vec<_>, Fault>>()?;
                let failed = !states.is_empty() && states.iter().all(|f| matches!(f, StoredUnitState::Failed(_)));
                if failed { states.swap_remove(0) } else { StoredUnitState::Unknown }
            }
        };
        if let StoredUnitState::Failed(why) = found {
            return Ok(StoredUnitState::Failed(why));
        }
    }
    Ok(StoredUnitState::Unknown)
}

/// Plan with all trials that follow from the scores in `store`. Returns the plan itself without a search, or if all
/// trials are known in advance.
///
/// # Errors
/// Fails if the plan of these trials is invalid, or if its sources or the store cannot be read.
pub fn settled(
    plan: Plan,
    catalogue: &[StageEntry],
    store: &Store,
    tick: &SourceReadCallback,
) -> Result<Plan, SpecFaults> {
    let Some(search) = plan.spec.search.clone() else { return Ok(plan) };
    match followed(&search, &plan, catalogue, store, tick)? {
        Some(course) => Plan::new(plan.spec.with_trials(&course.rows()), catalogue),
        None => Ok(plan),
    }
}

/// Plan with the maximum number of trials that a search can have, and the number of assumed trials among them. Assumed
/// trials follow from invented scores, because the scores that they depend on are not in `store` yet. The plan serves
/// to estimate the cost of the search, not to run it.
///
/// # Errors
/// Returns the errors of [`settled`].
pub fn plan_all_trials(
    plan: Plan,
    catalogue: &[StageEntry],
    store: &Store,
    tick: &SourceReadCallback,
) -> Result<(Plan, usize), SpecFaults> {
    let Some(search) = plan.spec.search.clone() else { return Ok((plan, 0)) };
    let Some(mut course) = followed(&search, &plan, catalogue, store, tick)? else { return Ok((plan, 0)) };
    let known = course.rows().len();
    while !course.next().is_empty() {
        let scored = course.next().iter().map(invented_score).collect();
        course.record_scores(scored);
    }
    let rows = course.rows();
    let assumed = rows.len() - known;
    Ok((Plan::new(plan.spec.with_trials(&rows), catalogue)?, assumed))
}

/// Row with an invented score that favours no value of an axis. The scores are the fractional parts of multiples of the
/// golden ratio, which are spread evenly.
fn invented_score(row: &SearchTrial) -> SearchTrialScore {
    const GOLDEN: f64 = 0.618_033_988_749_895;
    let cost = Some((row.trial as f64 * GOLDEN).fract());
    SearchTrialScore { row: row.clone(), goal: cost, cost, lines: 1, error: None, promoted: false }
}

/// State of a search after the last score in `store`; `None` if all trials are known in advance.
fn followed<'a>(
    search: &'a SearchSpec,
    plan: &Plan,
    catalogue: &[StageEntry],
    store: &Store,
    tick: &SourceReadCallback,
) -> Result<Option<SearchState<'a>>, SpecFaults> {
    let mut course = SearchState::new(search);
    if course.is_known() {
        return Ok(None);
    }
    while !course.next().is_empty() {
        let rows = course.next().to_vec();
        let next = Plan::new(plan.spec.with_trials(&rows), catalogue)?;
        let graph = PlanGraph::new(&next, store, tick)?;
        let found = scored(&graph, store, &rows, false).map_err(|f| plan.spec.faults(vec![f]))?;
        match found {
            Some(found) => course.record_scores(found),
            None => break,
        }
    }
    Ok(Some(course))
}

/// Sorts the computed trials by trial and rung.
pub fn in_order(mut done: Vec<SearchTrialScore>) -> Vec<SearchTrialScore> {
    done.sort_by_key(|s| (s.row.trial, s.row.rung));
    done
}
