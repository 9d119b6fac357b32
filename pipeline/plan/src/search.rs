//! The goal of a search: the table and the metric that it optimises.

use schemas::{
    Fault, Grain, Literal, TableKind,
    metric::{Metric, MetricPreference},
};

use super::{Plan, axes::unused, builder::PlanBuilder};
use crate::{
    predicate::Predicate,
    spec::{GoalDirection, SearchSpec},
};

/// The goal of a search, checked.
pub struct SearchGoal {
    /// Table of scores, as a position in the plan.
    pub table: usize,
    /// Metric.
    pub metric: Metric,
    /// Values of the metric that the search prefers.
    better: MetricPreference,
    /// Lines over which the goal is pooled; `None` for all lines.
    pub lines: Option<Predicate>,
}

impl SearchGoal {
    /// Cost of a value, smaller for better values; `None` if the value is not a number.
    pub fn cost(&self, value: f64) -> Option<f64> {
        self.better.cost(value)
    }
}

impl Plan {
    /// The goal of the spec's search; `None` without a search.
    ///
    /// # Errors
    /// Never fails for a checked plan.
    pub fn goal(&self) -> Result<Option<SearchGoal>, Fault> {
        let Some(search) = &self.spec.search else { return Ok(None) };
        let table = self.table(&search.table)?;
        let node = &self.tables[table];
        let metric = node.entry.metrics.iter().find(|m| m.name == search.metric).copied();
        let metric = metric.ok_or_else(|| Fault::bug("the goal of a search has no metric"))?;
        let better = match search.direction {
            None => metric.better,
            Some(GoalDirection::Minimise) => MetricPreference::Lower,
            Some(GoalDirection::Maximise) => MetricPreference::Higher,
        };
        let shape = node.tables.first().map(|t| t.shape().clone()).unwrap_or_default();
        let lines = search.predicate.as_ref().map(|(text, _)| Predicate::new(text, &shape)).transpose()?;
        Ok(Some(SearchGoal { table, metric, better, lines }))
    }
}

impl PlanBuilder<'_> {
    /// Checks the search against the stages: the searched axes are used, and the goal exists and depends on them.
    pub fn search(&mut self, search: &SearchSpec) {
        for name in unused(self.spec) {
            let at =
                search.columns().into_iter().find(|(n, _)| *n == name).map_or(search.at.clone(), |(_, at)| at.clone());
            let fault = Fault::new(format!("no stage uses the searched axis `{name}`")).at(at);
            self.faults.push(fault.help(format!("use the axis in a parameter: `\"${name}\"`")));
        }
        if self.broken.contains(&search.table) {
            return;
        }
        let goal = |fault: Fault| fault.at(search.goal_at.clone());
        let Some(node) = self.tables.iter().find(|t| t.name == search.table) else {
            let scores = self.tables.iter().filter(|t| !t.entry.metrics.is_empty());
            let known: Vec<&str> = scores.map(|t| t.name.as_str()).collect();
            let fault = Fault::new(format!("the table `{}` of `goal` does not exist", search.table));
            self.faults.push(goal(fault.nearest(&search.table, &known)));
            return;
        };
        let of_scores = node.entry.yields == TableKind::Scores && node.entry.grain == Grain::Line;
        if !of_scores || node.entry.metrics.is_empty() {
            let what = format!("the table `{}` of `goal` is not a table of line scores", node.name);
            self.faults.push(goal(Fault::new(what).help("give a table of the stage `score`")));
            return;
        }
        let known: Vec<&str> = node.entry.metrics.iter().map(|m| m.name).collect();
        let Some(metric) = node.entry.metrics.iter().find(|m| m.name == search.metric) else {
            let fault = Fault::new(format!("`{}` has no metric `{}`", node.name, search.metric));
            self.faults.push(goal(fault.nearest(&search.metric, &known)));
            return;
        };
        if metric.better == MetricPreference::Neither && search.direction.is_none() {
            let what = format!("the metric `{}` has no preferred direction", metric.name);
            self.faults.push(goal(Fault::new(what).help("set `direction = \"minimise\"` or `\"maximise\"`")));
        }
        let asked = self.spec.stages.get(node.decl).and_then(|d| d.args.get("metrics"));
        if let Some(Literal::List(items)) = asked.map(|given| &given.value) {
            let words: Vec<&str> = items.iter().filter_map(Literal::as_text).collect();
            if !words.contains(&metric.name) && !words.iter().any(|w| w.starts_with('$')) {
                let what = format!("`{}` is not among the `metrics` of `{}`", metric.name, node.name);
                self.faults.push(goal(Fault::new(what).help("add the metric to `metrics`")));
            }
        }
        if !node.axes.iter().any(|a| self.spec.searched.contains(a)) {
            let what = format!("the table `{}` of `goal` does not depend on a searched axis", node.name);
            self.faults.push(goal(Fault::new(what).help("use a searched axis in a stage that this table depends on")));
        }
        if let Some((text, at)) = &search.predicate {
            let shape = node.tables.first().map(|t| t.shape().clone()).unwrap_or_default();
            match Predicate::new(text, &shape) {
                Ok(predicate) if !predicate.is_of_lines() => {
                    let what = "`where` of a search selects lines, so it may use only `flight` and `line`";
                    self.faults.push(Fault::new(what).at(at.clone()));
                }
                Ok(_) => {}
                Err(fault) => self.faults.push(fault.at(at.clone())),
            }
        }
    }
}
