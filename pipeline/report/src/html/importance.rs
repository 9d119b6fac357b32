//! Importance of the inputs of a model: bars of the means over lines and seeds, with a dot for each, and the beeswarm
//! of samples.

use std::collections::BTreeMap;

use arrow_array::{Array, cast::AsArray, types::Float64Type};
use figures::chart::px;
use maud::{Markup, html};
use plan::{SweepPoint, spec::Spec};
use results::text::{number, point_words};
use schemas::{Fault, Literal, StageRole};

use super::{beeswarm::BeeswarmSamples, source::ReportSource};

/// The columns of the samples.
const SAMPLES: [&str; 2] = ["sample_values", "sample_inputs"];
/// Maximum numbers of groups and of models.
const GROUPS: usize = 20;
const MODELS: usize = 12;
/// Dimensions of a picture.
const LABEL: f64 = 210.0;
const WIDTH: f64 = 720.0;
const VALUE: f64 = 90.0;
const ROW: f64 = 22.0;

/// Importance of features in one model over all lines.
#[derive(Default)]
struct ImportanceRanking {
    method: String,
    unit: String,
    /// Absolute value of the importance of each group, one for each line.
    groups: BTreeMap<String, Vec<f64>>,
    /// The samples, if they are stored.
    swarm: BeeswarmSamples,
}

/// The axes whose values are seeds. Points that differ only in these axes are the same model with other random draws.
fn seeds(spec: &Spec) -> Vec<&str> {
    let given = spec.stages.iter().filter_map(|stage| match &stage.args.get("seed")?.value {
        Literal::Text(axis) => axis.strip_prefix('$'),
        _ => None,
    });
    given.collect()
}

/// The section of all tables of importance; `None` for a run without an importance table.
///
/// # Errors
/// Fails if a table cannot be read.
pub fn section(source: &ReportSource) -> Result<Option<Markup>, Fault> {
    let (graph, store) = (source.graph, source.store);
    let mut models: BTreeMap<(usize, usize), (String, ImportanceRanking)> = BTreeMap::new();
    let (seeds, mut first_of) = (seeds(&graph.plan.spec), BTreeMap::new());
    for t in graph.plan.tables_of(StageRole::RanksInputs) {
        let node = &graph.plan.tables[t];
        for unit in graph.units(t) {
            let Ok(key) = graph.key(unit) else { continue };
            if !store.has(key) || store.failed(key)?.is_some() {
                continue;
            }
            let batch = store.get(key, &["group", "value", "method", "unit"])?;
            let text = |i: usize| batch.column(i).as_string_opt::<i32>();
            let (Some(groups), Some(values), Some(methods), Some(units)) =
                (text(0), batch.column(1).as_primitive_opt::<Float64Type>(), text(2), text(3))
            else {
                continue;
            };
            let mut point: SweepPoint = graph.plan.instance(unit.table, unit.instance).point();
            point.retain(|axis, _| !seeds.contains(&axis.as_str()));
            let point = point_words(&point);
            let instance = *first_of.entry((t, point.clone())).or_insert(unit.instance);
            let (_, ranking) = models.entry((t, instance)).or_insert_with(|| {
                let title = if point.is_empty() { node.name.clone() } else { format!("{}: {point}", node.name) };
                (title, ImportanceRanking::default())
            });
            for i in (0..batch.num_rows()).filter(|i| values.is_valid(*i) && values.value(*i).is_finite()) {
                methods.value(i).clone_into(&mut ranking.method);
                units.value(i).clone_into(&mut ranking.unit);
                ranking.groups.entry(groups.value(i).to_owned()).or_default().push(values.value(i).abs());
            }
            if graph.plan.instance(unit.table, unit.instance).makes(SAMPLES[0]).is_some() {
                let batch = store.get(key, &SAMPLES)?;
                let list = |column: usize, i: usize| -> Vec<f64> {
                    let row = batch.column(column).as_fixed_size_list_opt().map(|list| list.value(i));
                    row.iter()
                        .filter_map(|row| row.as_primitive_opt::<Float64Type>())
                        .flat_map(|x| x.values().iter())
                        .copied()
                        .collect()
                };
                for i in 0..batch.num_rows() {
                    ranking.swarm.add(groups.value(i), &list(0, i), &list(1, i));
                }
            }
        }
    }
    let more = models.len().saturating_sub(MODELS);
    let drawn = models.into_values().take(MODELS);
    let drawn: Vec<Markup> = drawn
        .map(|(title, ranking)| {
            let swarm = ranking.swarm.drawn(&title, &ranking.unit);
            html! { (ranking.drawn(&title)) @if let Some(swarm) = swarm { (swarm) } }
        })
        .collect();
    Ok((!drawn.is_empty()).then(|| {
        html! {
            section id="importance" {
                h2 { "Importance of the inputs" }
                p.lead { "Each bar is the mean of the absolute values over the lines. Each dot is one line, or one \
                          random seed on a line. Correlated inputs share or mask importance." }
                @for picture in drawn { (picture) }
                @if more > 0 { p.note { (more) " further models are not drawn." } }
            }
        }
    }))
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

impl ImportanceRanking {
    fn drawn(&self, title: &str) -> Markup {
        let mut groups: Vec<(&String, &Vec<f64>)> = self.groups.iter().collect();
        groups.sort_by(|a, b| mean(b.1).total_cmp(&mean(a.1)).then_with(|| a.0.cmp(b.0)));
        let more = groups.len().saturating_sub(GROUPS);
        groups.truncate(GROUPS);
        let most = groups.iter().flat_map(|(_, v)| v.iter().copied()).fold(f64::MIN_POSITIVE, f64::max);
        let at = |value: f64| LABEL + (WIDTH - LABEL - VALUE) * value / most;
        let height = ROW * groups.len() as f64 + 4.0;
        let unit = if self.unit.is_empty() || self.unit == "1" { String::new() } else { format!(", {}", self.unit) };
        let what = format!("{}{unit}", self.method.replace('_', " "));
        html! {
            figure {
                figcaption { strong { (title) } " (" (what) ")" }
                svg.intervals viewBox=(format!("0 0 {WIDTH} {}", px(height))) role="img"
                    aria-label=(format!("{title}: {what}")) {
                    @for (row, (name, values)) in groups.iter().enumerate() {
                        @let (top, middle) = (ROW * row as f64 + 4.0, mean(values));
                        text.value x=(px(LABEL - 8.0)) y=(px(top + 12.0)) text-anchor="end" font-size="12" { (name) }
                        rect x=(px(LABEL)) y=(px(top)) width=(px(at(middle) - LABEL)) height=(px(ROW - 8.0))
                            fill="var(--band)" fill-opacity="0.28" {}
                        @for value in values.iter() {
                            circle.dot cx=(px(at(*value))) cy=(px(top + 7.0)) r="2.4" fill-opacity="0.7" {}
                        }
                        text.value x=(px(WIDTH - VALUE + 10.0)) y=(px(top + 12.0)) font-size="12" {
                            (number(Some(middle)))
                        }
                    }
                }
                @if more > 0 { p.note { (more) " less important groups are not shown." } }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_groups_are_in_the_order_of_their_means_with_a_dot_for_each_line() {
        let groups = [("a", vec![1.0, 2.0]), ("b", vec![5.0]), ("c", vec![0.5, 0.5, 0.5])];
        let groups = groups.into_iter().map(|(name, values)| (name.to_owned(), values)).collect();
        let ranking = ImportanceRanking {
            method: "permutation".into(),
            unit: "nT2".into(),
            groups,
            swarm: BeeswarmSamples::default(),
        };
        let drawn = ranking.drawn("importance").0;
        let places: Vec<usize> = [">b<", ">a<", ">c<"].iter().filter_map(|name| drawn.find(name)).collect();
        assert!(places.len() == 3 && places.is_sorted(), "{drawn}");
        assert_eq!(drawn.matches("<circle").count(), 6);
        assert!(drawn.contains("permutation, nT2"));
    }
}
