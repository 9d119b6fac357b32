//! The table of scores as a person reads it: one row a sweep point, one column a metric, lines pooled.

use std::path::Path;

use polars::prelude::{Column, DataFrame, DataType, GroupsIndicator, ParquetReader, PolarsError, SerReader};
use schemas::Fault;
use stages::numerics::statistics::Pool;

/// The metrics worth a column, in their order.
const SHOWN: [&str; 15] = [
    "std_uncompensated",
    "std_error",
    "improvement_ratio",
    "improvement_ratio_band",
    "snr",
    "anomaly_retention",
    "figure_of_merit",
    "figure_of_merit_crossings",
    "ins_drms",
    "drms",
    "nees",
    "nis",
    "map_std_error",
    "map_gradient_along_track",
    "map_position_bound",
];

/// Scores of all lines together, by sweep point.
pub struct Scores {
    /// The axes, in the sweep's order.
    pub axes: Vec<String>,
    /// (metric, unit) of each column.
    pub metrics: Vec<(String, String)>,
    /// One row a sweep point: the axis values as text, then a value for each metric.
    pub rows: Vec<(Vec<String>, Vec<Option<f64>>)>,
    /// How many lines went into them.
    pub lines: usize,
}

/// Reads the score table in `folder`, whose axes are `axes`.
///
/// Errors in nT and m are pooled over the lines as root mean squares weighted by samples, ratios as means weighted
/// likewise.
///
/// # Errors
/// When the table cannot be read.
pub fn scores(folder: &Path, axes: &[String]) -> Result<Scores, Fault> {
    pool(folder, axes).map_err(|e| Fault::machine(format!("cannot read the scores in {}: {e}", folder.display())))
}

fn pool(folder: &Path, axes: &[String]) -> Result<Scores, PolarsError> {
    let file = std::fs::File::open(folder.join("part-0.parquet"))?;
    let all = ParquetReader::new(file).finish()?;
    let lines = all.group_by_stable(["flight", "line"])?.get_groups().len();
    let (value, n) = (all.column("value")?.f64()?.clone(), all.column("n")?.i64()?.clone());
    let (metric, unit) = (all.column("metric")?.str()?.clone(), all.column("unit")?.str()?.clone());
    let by = all.group_by_stable(axes.iter().map(String::as_str).chain(["metric", "unit"]))?;
    let one = |rows: Vec<usize>| {
        let first = rows.first().copied().unwrap_or(0);
        let how = Pool::of(metric.get(first).unwrap_or_default(), unit.get(first).unwrap_or_default());
        let figures = rows.iter().filter_map(|i| Some((value.get(*i)?, n.get(*i)? as f64)));
        Some(how.value(figures)).filter(|v| !v.is_nan())
    };
    let pooled: Vec<Option<f64>> = by.get_groups().iter().map(|g| one(rows_of(g))).collect();
    let keys = DataFrame::new_infer_height(by.keys())?;
    gather(&keys, &pooled, axes, lines)
}

fn rows_of(group: GroupsIndicator) -> Vec<usize> {
    match group {
        GroupsIndicator::Idx((_, rows)) => rows.iter().map(|i| *i as usize).collect(),
        GroupsIndicator::Slice([first, count]) => (first as usize..first as usize + count as usize).collect(),
    }
}

/// Long to wide, in the order in which points and metrics first appear.
fn gather(groups: &DataFrame, pooled: &[Option<f64>], axes: &[String], lines: usize) -> Result<Scores, PolarsError> {
    let text = |name: &str| -> Result<Vec<String>, PolarsError> {
        let column: Column = groups.column(name)?.cast(&DataType::String)?;
        Ok(column.str()?.iter().map(|x| x.unwrap_or_default().to_owned()).collect())
    };
    let keys = axes.iter().map(|a| text(a)).collect::<Result<Vec<_>, _>>()?;
    let (names, units) = (text("metric")?, text("unit")?);
    let has_value = |m: &str| (0..names.len()).find(|i| names[*i] == m && pooled.get(*i).copied().flatten().is_some());
    let present = SHOWN.iter().filter_map(|m| has_value(m).map(|i| ((*m).to_owned(), units[i].clone())));
    let metrics: Vec<(String, String)> = present.collect();
    let mut rows: Vec<(Vec<String>, Vec<Option<f64>>)> = vec![];
    for i in 0..groups.height() {
        let Some(at) = metrics.iter().position(|(m, _)| *m == names[i]) else { continue };
        let key: Vec<String> = keys.iter().map(|k| k[i].clone()).collect();
        let row = match rows.iter().position(|(k, _)| *k == key) {
            Some(r) => r,
            None => {
                rows.push((key, vec![None; metrics.len()]));
                rows.len() - 1
            }
        };
        rows[row].1[at] = pooled.get(i).copied().flatten();
    }
    Ok(Scores { axes: axes.to_vec(), metrics, rows, lines })
}

/// A number as it is read: four significant digits.
pub fn number(x: Option<f64>) -> String {
    match x {
        None => "-".to_owned(),
        Some(0.0) => "0".to_owned(),
        Some(x) => {
            let digits = (3 - x.abs().log10().floor() as i64).clamp(0, 6);
            format!("{x:.*}", usize::try_from(digits).unwrap_or(0))
        }
    }
}

/// The scores as text, at most `most` rows.
pub fn render(scores: &Scores, most: usize) -> String {
    let header = scores.axes.iter().cloned();
    let header =
        header.chain(scores.metrics.iter().map(|(m, u)| if u == "1" { m.clone() } else { format!("{m} [{u}]") }));
    let mut table = vec![header.collect::<Vec<String>>()];
    for (key, values) in scores.rows.iter().take(most) {
        table.push(key.iter().cloned().chain(values.iter().map(|v| number(*v))).collect());
    }
    let mut out = columns(&table, scores.axes.len());
    if scores.rows.len() > most {
        out.push_str(&format!("and {} more points; `magline sql` shows them all\n", scores.rows.len() - most));
    }
    out
}

/// Rows of words in columns: the first `left` flush left, the others flush right.
pub fn columns(table: &[Vec<String>], left: usize) -> String {
    let count = table.iter().map(Vec::len).max().unwrap_or(0);
    let wide = |c: usize| table.iter().filter_map(|r| r.get(c)).map(|w| w.chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..count).map(wide).collect();
    let cell = |(c, word): (usize, &String)| {
        if c < left { format!("{word:<w$}", w = widths[c]) } else { format!("{word:>w$}", w = widths[c]) }
    };
    let line = |row: &Vec<String>| {
        row.iter().enumerate().map(cell).collect::<Vec<_>>().join("  ").trim_end().to_owned() + "\n"
    };
    table.iter().map(line).collect()
}
