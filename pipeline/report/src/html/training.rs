//! Training of the models: the losses of their epochs.

use arrow_array::{Array, cast::AsArray, types::Float64Type};
use figures::chart::{ChartAxis, ChartLine, LineChart};
use maud::{Markup, html};
use results::text::point_words;
use schemas::{Fault, StageRole};

use super::source::ReportSource;

const HEIGHT: f64 = 260.0;
/// Maximum number of drawn trainings.
const MOST: usize = 12;

/// Training and validation loss by epoch.
#[derive(Default)]
pub struct LossCurve {
    /// Epoch and training loss.
    pub training: Vec<(f64, f64)>,
    /// Epoch and validation loss.
    pub validation: Vec<(f64, f64)>,
}

/// The section of all trainings of the plan; `None` without a trained model.
///
/// # Errors
/// Fails if a model cannot be read.
pub fn section(source: &ReportSource) -> Result<Option<Markup>, Fault> {
    let (graph, store) = (source.graph, source.store);
    let (mut charts, mut more) = (vec![], 0);
    for t in graph.plan.tables_of(StageRole::FitsModel) {
        let node = &graph.plan.tables[t];
        for unit in graph.units(t) {
            let Ok(key) = graph.key(unit) else { continue };
            if !store.has(key) || store.failed(key)?.is_some() {
                continue;
            }
            let batch = store.get(key, &["term", "value"])?;
            let (Some(terms), Some(values)) =
                (batch.column(0).as_string_opt::<i32>(), batch.column(1).as_primitive_opt::<Float64Type>())
            else {
                continue;
            };
            let rows = (0..terms.len()).filter(|i| terms.is_valid(*i) && values.is_valid(*i));
            let curve = LossCurve::from_terms(rows.map(|i| (terms.value(i), values.value(i))));
            if curve.training.len() < 2 {
                continue;
            }
            if charts.len() >= MOST {
                more += 1;
                continue;
            }
            let point = point_words(&graph.plan.instance(unit.table, unit.instance).point());
            let title = if point.is_empty() { node.name.clone() } else { format!("{}: {point}", node.name) };
            charts.extend(curve.chart(title));
        }
    }
    Ok((!charts.is_empty()).then(|| {
        html! {
            section id="training" {
                h2 { "Training" }
                p.lead { "The loss of each epoch, divided by the square of the target's scale, on a logarithmic axis. \
                          A validation loss that rises while the training loss falls indicates overfitting." }
                div.heat { @for chart in charts { (chart) } }
                @if more > 0 { p.note { (more) " more curves are not drawn." } }
            }
        }
    }))
}

impl LossCurve {
    /// Learning curve from the terms of a model; for several networks, the curve of the first network.
    pub fn from_terms<'a>(terms: impl Iterator<Item = (&'a str, f64)>) -> LossCurve {
        let mut curve = LossCurve::default();
        let epoch = |term: &str, key: &str| -> Option<f64> {
            term.strip_prefix(key)?.strip_prefix('[')?.strip_suffix(']')?.parse().ok()
        };
        for (term, loss) in terms.filter(|(_, loss)| *loss > 0.0) {
            curve.training.extend(epoch(term, "epoch_training").map(|x| (x, loss)));
            curve.validation.extend(epoch(term, "epoch_validation").map(|x| (x, loss)));
        }
        for points in [&mut curve.training, &mut curve.validation] {
            points.sort_by(|a, b| a.0.total_cmp(&b.0));
        }
        curve
    }

    fn chart(self, title: String) -> Option<Markup> {
        let best = self.validation.iter().min_by(|a, b| a.1.total_cmp(&b.1)).copied();
        let caption = match best {
            Some((epoch, loss)) => format!("The lowest validation loss is {loss:.4}, in epoch {epoch}."),
            None => "No lines were held out for validation.".to_owned(),
        };
        let mut lines = vec![ChartLine { name: "training".into(), class: "after", points: self.training }];
        if best.is_some() {
            lines.push(ChartLine { name: "validation".into(), class: "before", points: self.validation });
        }
        let marks = best.map(|(x, y)| ("least".to_owned(), x, y)).into_iter().collect();
        let chart = LineChart {
            title,
            caption,
            x: ChartAxis::new("epoch"),
            y: ChartAxis::new("loss").log(),
            lines,
            marks,
            height: HEIGHT,
            half: true,
            ..LineChart::default()
        };
        chart.draw()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_a_curve_is_made_of_the_terms_of_epochs_in_their_order() {
        let terms = [("epoch_training[2]", 0.5), ("x", 3.0), ("epoch_training[1]", 0.9), ("epoch_rate[1]", 0.1)];
        let more =
            [("epoch_validation[1]", 1.0), ("epoch_validation[2]", f64::NAN), ("member2.epoch_training[1]", 7.0)];
        let curve = LossCurve::from_terms(terms.into_iter().chain(more));
        assert_eq!(curve.training, [(1.0, 0.9), (2.0, 0.5)]);
        assert_eq!(curve.validation, [(1.0, 1.0)]);
        assert!(curve.chart("network".into()).is_some_and(|m| m.0.contains("in epoch 1")));
    }
}
