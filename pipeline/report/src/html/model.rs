//! The coefficients of a fitted model.

use arrow_array::{
    Array, RecordBatch,
    cast::AsArray,
    types::{Float64Type, Int64Type},
};
use maud::{Markup, html};
use plan::{PlanUnit, TableRef};
use results::text::number;
use schemas::Fault;

use super::{source::ReportSource, subject::ReportSubject};

/// Condition number from which individual coefficients have at least three significant digits fewer than the data.
const LARGE_CONDITION: f64 = 1000.0;

/// One term of a model.
#[derive(Clone, Debug, PartialEq)]
struct ReportModelTerm {
    name: String,
    value: f64,
    sigma: f64,
}

/// A fitted model.
struct ReportModel {
    terms: Vec<ReportModelTerm>,
    rows: i64,
    left_out: i64,
    condition: f64,
    residual_nt: f64,
    trivial_share: f64,
    approximation_nt: f64,
    warning: String,
}

/// The model of one sweep point; `None` if the point has no model.
///
/// # Errors
/// Fails if the store is damaged.
pub fn table(source: &ReportSource, subject: &ReportSubject) -> Result<Option<Markup>, Fault> {
    let Some(TableRef::Stage(table, instance)) = subject.fit else { return Ok(None) };
    let columns = [
        "term",
        "value",
        "std",
        "n",
        "left_out",
        "condition",
        "residual_std",
        "trivial_share",
        "approximation_bound",
        "warning",
    ];
    let batch = source.tidy(PlanUnit { table, instance, line: None }, &columns)?;
    let name = &source.graph.plan.tables[table].name;
    Ok(batch.as_ref().and_then(ReportModel::read).map(|m| m.drawn(name)))
}

impl ReportModel {
    fn read(batch: &RecordBatch) -> Option<ReportModel> {
        let floats = |name: &str| batch.column_by_name(name).and_then(|a| a.as_primitive_opt::<Float64Type>());
        let whole = |name: &str| batch.column_by_name(name).and_then(|a| a.as_primitive_opt::<Int64Type>());
        let names = batch.column_by_name("term").and_then(|a| a.as_string_opt::<i32>())?;
        let (values, sigmas) = (floats("value")?, floats("std")?);
        let at = |a: &arrow_array::Float64Array, i: usize| if a.is_valid(i) { a.value(i) } else { f64::NAN };
        let term =
            |i: usize| ReportModelTerm { name: names.value(i).to_owned(), value: at(values, i), sigma: at(sigmas, i) };
        let first = |name: &str| floats(name).map_or(f64::NAN, |a| at(a, 0));
        let count = |name: &str| whole(name).filter(|a| a.is_valid(0)).map_or(0, |a| a.value(0));
        let words = |name: &str| batch.column_by_name(name).and_then(|a| a.as_string_opt::<i32>());
        let text = |name: &str| words(name).filter(|a| a.is_valid(0)).map_or(String::new(), |a| a.value(0).to_owned());
        (batch.num_rows() > 0).then(|| ReportModel {
            terms: (0..batch.num_rows()).map(term).collect(),
            rows: count("n"),
            left_out: count("left_out"),
            condition: first("condition"),
            residual_nt: first("residual_std"),
            trivial_share: first("trivial_share"),
            approximation_nt: first("approximation_bound"),
            warning: text("warning"),
        })
    }

    fn drawn(&self, name: &str) -> Markup {
        let widest =
            self.terms.iter().map(|t| t.value.abs() + 2.0 * t.sigma).filter(|v| v.is_finite()).fold(0.0, f64::max);
        html! {
            div.model {
                h3 { "The model: table " (name) }
                @if !self.warning.is_empty() {
                    p.warning role="alert" { strong { "This fit is not reliable: " } (self.warning) "." }
                }
                p { (self.rows) " samples were used and " (self.left_out) " were excluded. \
                    The residual of the filtered target has a standard deviation of "
                    (number(Some(self.residual_nt))) " nT. The condition number of the matrix is "
                    strong { (number(Some(self.condition))) } ". " (self.verdict()) (self.form()) }
                div.scroll { table.sortable {
                    thead { tr {
                        th scope="col" { button { "term" } }
                        th.n scope="col" { button { "coefficient [nT]" } }
                        th.n scope="col" { button { "σ [nT]" } }
                        th.n scope="col" { button { "|coefficient| / σ" } }
                        th scope="col" { "coefficient ± 2σ" }
                    } }
                    tbody { @for term in &self.terms { tr.faint[term.is_lost()] {
                        td { (term.name) }
                        td.n data-v=(term.value) { (number(Some(term.value))) }
                        td.n data-v=(term.sigma) { (number(Some(term.sigma))) }
                        td.n data-v=(term.ratio()) { (number(Some(term.ratio()))) }
                        td { (term.whisker(widest)) }
                    } } }
                } }
                p.note { "Terms within 2σ of zero are grey. They are not significant." }
            }
        }
    }

    /// The diagnostics of the model's form.
    fn form(&self) -> String {
        let mut out = String::new();
        if self.trivial_share.is_finite() {
            let share = number(Some(100.0 * self.trivial_share));
            out.push_str(&format!(" The fit attributes {share} % of the total field to the aircraft."));
        }
        if self.approximation_nt.is_finite() {
            let bound = number(Some(self.approximation_nt));
            out.push_str(&format!(" The linearisation error is at most {bound} nT."));
        }
        out
    }

    fn verdict(&self) -> String {
        if !self.condition.is_finite() {
            return "The matrix is singular: some terms are exact linear combinations of others. The coefficients of \
                    these terms are meaningless."
                .to_owned();
        }
        if self.condition < LARGE_CONDITION {
            return "This value is moderate: the data of the flight distinguish the terms.".to_owned();
        }
        format!(
            "This value is large: the terms are nearly collinear. An error in the data may be amplified up to {} times \
             in a single coefficient. The sum of the terms may still be accurate. To reduce the condition number, fly \
             more varied manoeuvres, use fewer terms or increase lambda.",
            number(Some(self.condition))
        )
    }
}

impl ReportModelTerm {
    fn ratio(&self) -> f64 {
        self.value.abs() / self.sigma
    }

    fn is_lost(&self) -> bool {
        self.ratio() < 2.0
    }

    fn whisker(&self, widest: f64) -> Markup {
        let at = |v: f64| 90.0 + 86.0 * (v / widest).clamp(-1.0, 1.0);
        html! {
            @if widest > 0.0 && self.value.is_finite() && self.sigma.is_finite() {
                svg.whisker viewBox="0 0 180 14" aria-hidden="true" {
                    line.zero x1="90" x2="90" y1="0" y2="14" {}
                    line.arm x1=(format!("{:.1}", at(self.value - 2.0 * self.sigma)))
                        x2=(format!("{:.1}", at(self.value + 2.0 * self.sigma))) y1="7" y2="7" {}
                    circle.dot cx=(format!("{:.1}", at(self.value))) cy="7" r="3" {}
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn model(condition: f64) -> ReportModel {
        let term = |name: &str, value, sigma| ReportModelTerm { name: name.to_owned(), value, sigma };
        let terms = vec![term("permanent_x", 250.0, 2.0), term("eddy_xy", -1.0, 3.0)];
        ReportModel {
            terms,
            rows: 100,
            left_out: 4,
            condition,
            residual_nt: 0.5,
            trivial_share: 0.01,
            approximation_nt: 0.4,
            warning: String::new(),
        }
    }

    #[test]
    fn unit_a_large_condition_number_is_reported() {
        assert!(model(999.0).verdict().contains("moderate"));
        assert!(model(25_000.0).verdict().contains("up to 25000 times"));
        assert!(model(f64::INFINITY).verdict().contains("singular"));
    }

    #[test]
    fn unit_a_warning_precedes_the_coefficients() {
        let sound = model(10.0).drawn("coefficients").into_string();
        assert!(!sound.contains("role=\"alert\"") && sound.contains("is at most 0.4000 nT"), "{sound}");
        let warned = ReportModel { warning: "the flight hardly excites `xx`".into(), ..model(10.0) };
        let text = warned.drawn("coefficients").into_string();
        let (at, table) = (text.find("the flight hardly excites `xx`"), text.find("<table"));
        assert!(at.is_some() && at < table, "{text}");
    }

    #[test]
    fn unit_insignificant_coefficients_are_faint() {
        let text = model(10.0).drawn("coefficients").into_string();
        assert_eq!(text.matches("class=\"faint\"").count(), 1);
        assert!(text.contains("<td>permanent_x</td>") && text.contains("125.0"), "{text}");
    }
}
