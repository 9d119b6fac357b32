//! Variation of a model's coefficients between calibrations. [Gnadt 2022, Tables 3.1, 3.2, Figure 3-8]

use arrow_array::{cast::AsArray, types::Float64Type};
use figures::chart::{ChartAxis, ChartLine, LineChart};
use maud::{Markup, html};
use numerics::compensation::diagnostics::{CoefficientVariation, variation};
use plan::{PlanUnit, StageInstance, TableRef};
use results::text::number;
use schemas::{Fault, StageRole};

use super::source::ReportSource;

/// Maximum number of calibrations with a separate column.
const COLUMNS: usize = 8;

/// Models that differ only in one axis.
struct Calibrations {
    /// The axis.
    axis: String,
    /// Whether the axis selects the rows that a model is fitted to, rather than another parameter.
    of_rows: bool,
    /// Points of these models in the table; if there are too many points, an evenly spaced selection.
    members: Vec<usize>,
    /// Number of all such models.
    all: usize,
}

/// The coefficients of some models with the same terms.
struct ModelCoefficients {
    terms: Vec<String>,
    /// Value of the axis and coefficients of the terms, for each model.
    models: Vec<(String, Vec<f64>)>,
}

/// Maximum number of models that are read for the variation.
const MEMBERS: usize = 200;

/// Maximum number of tables of models that are shown.
const TABLES: usize = 4;

/// The variation of coefficients in each table whose models are fitted to different rows, for example to several
/// calibrations. If there is no such table, the variation of the models of `fit` over any axis is shown. `None` without
/// comparable models.
///
/// # Errors
/// Fails if the store is damaged.
pub fn section(source: &ReportSource, fit: Option<TableRef>) -> Result<Option<Markup>, Fault> {
    let mut parts = vec![];
    for table in source.graph.plan.tables_of(StageRole::FitsModel) {
        let instance = fit.and_then(|r| if let TableRef::Stage(t, i) = r { (t == table).then_some(i) } else { None });
        if parts.len() < TABLES {
            parts.extend(of_table(source, table, instance.unwrap_or(0), true)?);
        }
    }
    if let (true, Some(TableRef::Stage(table, instance))) = (parts.is_empty(), fit) {
        parts.extend(of_table(source, table, instance, false)?);
    }
    Ok((!parts.is_empty()).then(|| {
        html! { section id="variation" { h2 { "Variation of the coefficients" } @for part in &parts { (part) } } }
    }))
}

fn of_table(source: &ReportSource, table: usize, instance: usize, of_rows: bool) -> Result<Vec<Markup>, Fault> {
    let node = &source.graph.plan.tables[table];
    let mut parts = vec![];
    for one in calibrations(source, table, instance).iter().filter(|c| c.of_rows == of_rows) {
        let Some(found) = ModelCoefficients::read(source, table, one)? else { continue };
        let chart = if of_rows { over_lambda(source, table, instance, one)? } else { None };
        let others = node.axis_columns(&source.graph.plan.instance(table, instance), &source.graph.plan.spec);
        let others = others.iter().filter(|(name, _)| *name != one.axis).map(|(name, v)| format!("{name} = {v}"));
        let title = std::iter::once(format!("Table {}", node.name)).chain(others).collect::<Vec<_>>().join(", ");
        parts.push(found.drawn(&title, one, chart)?);
    }
    Ok(parts)
}

/// The value of an axis at a point, as text.
fn spelt(instance: &StageInstance, axis: &str) -> String {
    instance.point().get(axis).map(ToString::to_string).unwrap_or_default()
}

/// The magnetometer to which a model is fitted, as text.
fn target(instance: &StageInstance) -> Option<String> {
    instance.params().into_iter().find(|(name, _)| *name == "target").map(|(_, value)| value)
}

/// Models of the same magnetometer that differ from the model at `instance` in one axis alone, for each axis of the
/// table.
fn calibrations(source: &ReportSource, table: usize, instance: usize) -> Vec<Calibrations> {
    let plan = source.graph.plan;
    let node = &plan.tables[table];
    let own_target = target(&plan.instance(table, instance));
    let values_of_axis = |axis: &usize| {
        // Coefficients of different magnetometers have no common mean.
        let same = |i: &usize| target(&plan.instance(table, *i)) == own_target;
        let along: Vec<usize> = node.grid().along(instance, *axis).filter(same).collect();
        let all = along.len();
        let members: Vec<usize> = along.into_iter().step_by(all.div_ceil(MEMBERS).max(1)).collect();
        let rows = |i: &usize| {
            let of_rows = plan.instance(table, *i).predicate.as_ref().map(|p| p.canonical.clone());
            (source.graph.line_set(table, *i), of_rows)
        };
        let of_rows = members.iter().any(|i| rows(i) != rows(&instance));
        Calibrations { axis: plan.spec.axes[*axis].name.clone(), of_rows, members, all }
    };
    node.axes.iter().map(values_of_axis).filter(|c| c.members.len() > 1).collect()
}

impl ModelCoefficients {
    /// Reads the coefficients; `None` for fewer than two models, or models with different terms.
    fn read(source: &ReportSource, table: usize, of: &Calibrations) -> Result<Option<ModelCoefficients>, Fault> {
        let mut found = ModelCoefficients { terms: vec![], models: vec![] };
        for instance in &of.members {
            let unit = PlanUnit { table, instance: *instance, line: None };
            let Some(batch) = source.tidy(unit, &["term", "value"])? else { continue };
            let (Some(terms), Some(values)) =
                (batch.column(0).as_string_opt::<i32>(), batch.column(1).as_primitive_opt::<Float64Type>())
            else {
                return Ok(None);
            };
            let terms: Vec<String> = terms.iter().map(|t| t.unwrap_or_default().to_owned()).collect();
            if found.models.is_empty() {
                found.terms = terms;
            } else if found.terms != terms {
                return Ok(None);
            }
            let label = spelt(&source.graph.plan.instance(table, *instance), &of.axis);
            found.models.push((label, values.iter().map(|v| v.unwrap_or(f64::NAN)).collect()));
        }
        Ok((found.models.len() > 1).then_some(found))
    }

    fn variation(&self) -> Result<Vec<CoefficientVariation>, Fault> {
        let slices: Vec<&[f64]> = self.models.iter().map(|(_, c)| c.as_slice()).collect();
        variation(&slices).map_err(|e| Fault::machine(e.to_string()))
    }

    fn drawn(&self, title: &str, of: &Calibrations, chart: Option<Markup>) -> Result<Markup, Fault> {
        let spread = self.variation()?;
        let single = self.models.len() <= COLUMNS;
        let what = if of.of_rows { "calibrations" } else { "models" };
        Ok(html! {
            h3 {
                (title) ": over " (of.axis) ", " (self.models.len()) @if of.all > of.members.len() { " of " (of.all) }
                " " (what)
            }
            p.lead {
                "The coefficient of variation is the standard deviation divided by the absolute mean. Averaged over \
                 all terms, it is "
                strong { (number(mean_of(&spread))) }
                ". It is large for terms that change sign. Differences between calibrations are not caused by the \
                 aircraft alone. A larger lambda makes coefficients smaller and more similar."
            }
            div.scroll { table.sortable {
                thead { tr {
                    th scope="col" { button { "term" } }
                    th.n scope="col" { button { "mean [nT]" } }
                    th.n scope="col" { button { "std [nT]" } }
                    th.n scope="col" { button { "std / |mean|" } }
                    @if single { @for (label, _) in &self.models { th.n scope="col" { button { (label) " [nT]" } } } }
                } }
                tbody { @for (j, (term, v)) in self.terms.iter().zip(&spread).enumerate() { tr {
                    td { (term) }
                    (cell(v.mean)) (cell(v.std)) (cell(v.coefficient_of_variation))
                    @if single { @for (_, c) in &self.models { (cell(c.get(j).copied().unwrap_or(f64::NAN))) } }
                } } }
            } }
            @if let Some(chart) = chart { (chart) }
        })
    }
}

fn cell(value: f64) -> Markup {
    html! { td.n data-v=(value) { (number(Some(value).filter(|v| v.is_finite()))) } }
}

/// The mean of the available coefficients of variation.
fn mean_of(spread: &[CoefficientVariation]) -> Option<f64> {
    let there: Vec<f64> = spread.iter().map(|v| v.coefficient_of_variation).filter(|v| v.is_finite()).collect();
    (!there.is_empty()).then(|| there.iter().sum::<f64>() / there.len() as f64)
}

/// Plot of the mean coefficient of variation over the ridge parameter, if the sweep has several values of this
/// parameter. [Gnadt 2022, Figure 3-8]
fn over_lambda(
    source: &ReportSource,
    table: usize,
    instance: usize,
    of: &Calibrations,
) -> Result<Option<Markup>, Fault> {
    let lambda = |i: usize| {
        let params = source.graph.plan.instance(table, i).params();
        params.iter().find(|(name, _)| *name == "lambda").and_then(|(_, v)| v.parse::<f64>().ok())
    };
    let others = calibrations(source, table, instance);
    let swept = others.iter().find(|c| c.axis != of.axis && c.members.iter().any(|i| lambda(*i) != lambda(instance)));
    let Some(swept) = swept else { return Ok(None) };
    let mut points = vec![];
    for at in &swept.members {
        let group = calibrations(source, table, *at).into_iter().find(|c| c.axis == of.axis);
        let (Some(group), Some(lambda)) = (group, lambda(*at)) else { continue };
        if let Some(found) = ModelCoefficients::read(source, table, &group)? {
            points.extend(mean_of(&found.variation()?).map(|mean| (lambda, mean)));
        }
    }
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    let x = ChartAxis::new("lambda");
    let chart = LineChart {
        title: "Similarity of calibrations".into(),
        caption:
            "The mean of std / |mean| over all terms. A large ridge parameter makes calibrations similar. The scores \
             show whether they are also accurate."
                .into(),
        // A logarithmic axis cannot show 0.
        x: if points.first().is_some_and(|p| p.0 > 0.0) { x.log() } else { x },
        y: ChartAxis::new("mean coefficient of variation").log(),
        lines: vec![ChartLine { name: "mean over the terms".into(), class: "after", points }],
        height: 260.0,
        ..LineChart::default()
    };
    Ok(chart.draw())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn ref_table_3_1_of_gnadt_2022() {
        // Coefficients cosX and cosYZ of the lines 1001.01, 1002.02 and 1006.04.
        let models = [("1001.01", [1974.0, -18.0]), ("1002.02", [1798.0, 180.0]), ("1006.04", [1243.0, 190.0])];
        let found = ModelCoefficients {
            terms: vec!["x".into(), "yz".into()],
            models: models.map(|(line, c)| (line.to_owned(), c.to_vec())).to_vec(),
        };
        let of = Calibrations { axis: "calibration".into(), of_rows: true, members: vec![0, 1, 2], all: 3 };
        let text = found.drawn("Table fits", &of, None).unwrap().into_string();
        assert!(text.contains("3 calibrations") && text.contains("1672") && text.contains("1006.04 [nT]"), "{text}");
        let spread = found.variation().unwrap();
        // Expected values, computed by hand: 381.5/1671.7 and 117.3/117.3.
        assert!((spread[0].coefficient_of_variation - 0.228).abs() < 1e-3);
        assert!((spread[1].coefficient_of_variation - 1.0).abs() < 2e-3, "{}", spread[1].coefficient_of_variation);
    }
}
