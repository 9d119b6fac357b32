//! The variables of a MATLAB file, and the tables that they form.

use std::collections::BTreeMap;

use crate::table::ColumnValues;

/// A variable, or a field of a structure.
#[derive(Debug)]
pub(super) struct MatVariable {
    pub(super) name: String,
    pub(super) content: MatValue,
}

impl MatVariable {
    pub(super) fn skipped(name: &str, why: &'static str) -> MatVariable {
        MatVariable { name: name.to_owned(), content: MatValue::Skipped(why) }
    }
}

/// The value of a variable.
#[derive(Debug)]
pub(super) enum MatValue {
    /// Numbers of a matrix, column after column; `None` if only the shape was read.
    Array { rows: u64, columns: u64, values: Option<ColumnValues> },
    /// The rows of a matrix of characters, or the strings of a cell array.
    Texts(Vec<String>),
    /// One structure.
    Struct(Vec<MatVariable>),
    /// A variable that is not read, with its type.
    Skipped(&'static str),
}

/// The variables of a file, and notes for the user.
#[derive(Default)]
pub(super) struct MatContents {
    pub(super) nodes: Vec<MatVariable>,
    pub(super) notes: Vec<String>,
}

/// A table: columns of one length.
pub(super) struct MatTable {
    pub(super) name: String,
    pub(super) rows: u64,
    pub(super) columns: Vec<MatColumn>,
}

/// A column of a table.
pub(super) struct MatColumn {
    pub(super) name: String,
    rows: u64,
    /// The variable of the column.
    pub(super) variable: String,
    /// Values; `None` if only the shape was read.
    pub(super) values: Option<ColumnValues>,
}

/// The table of the vectors at the root.
pub(super) const ROOT: &str = ".";
/// A matrix with more columns than this, and at most [`MOST_CHANNELS`] rows, has one channel per row.
const MOST_COLUMNS: u64 = 1000;
/// Maximum number of rows of a matrix with one channel per row.
const MOST_CHANNELS: u64 = 100;

/// The tables of a file: one for each matrix and structure, and one for the vectors at the root. Vectors of an uncommon
/// length are a separate table named with their length: `log:1531`.
pub(super) fn tables(nodes: Vec<MatVariable>) -> Vec<MatTable> {
    let mut labels: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for node in &nodes {
        if let (Some(of), MatValue::Texts(texts)) = (node.name.strip_suffix("_label"), &node.content) {
            labels.insert(of.to_owned(), texts.clone());
        }
    }
    let (mut drafts, mut root) = (vec![], vec![]);
    for MatVariable { name, content } in nodes {
        match content {
            MatValue::Array { rows, columns, values } => {
                let labels = labels.get(&name).and_then(|l| named(l, rows, columns));
                if labels.is_none() && (rows == 1 || columns == 1) {
                    root.push(MatColumn { variable: name.clone(), name, rows: rows * columns, values });
                    continue;
                }
                let columns = split(&name, &name, (rows, columns), values, labels);
                drafts.extend(group(&name, columns));
            }
            MatValue::Struct(fields) => {
                let mut columns = vec![];
                flatten(&name, "", fields, &mut columns);
                drafts.extend(group(&name, columns));
            }
            MatValue::Texts(_) | MatValue::Skipped(_) => {}
        }
    }
    drafts.extend(group(ROOT, root));
    drafts
}

/// Names of the variables of a file that are in no table, each with the reason.
pub(super) fn skipped(nodes: &[MatVariable]) -> Vec<String> {
    let mut out = vec![];
    fn add(prefix: &str, nodes: &[MatVariable], out: &mut Vec<String>) {
        for MatVariable { name, content } in nodes {
            match content {
                MatValue::Skipped("empty") | MatValue::Array { .. } | MatValue::Texts(_) => {}
                MatValue::Skipped(why) => out.push(format!("`{prefix}{name}` ({why})")),
                MatValue::Struct(fields) => add(&format!("{prefix}{name}."), fields, out),
            }
        }
    }
    add("", nodes, &mut out);
    out
}

/// The labels of the columns of a matrix, if they are distinct.
fn named(labels: &[String], rows: u64, columns: u64) -> Option<Vec<String>> {
    let labels: Vec<String> = labels.iter().map(|l| l.trim().to_owned()).collect();
    let twice = labels.iter().enumerate().any(|(i, l)| l.is_empty() || labels.iter().take(i).any(|m| m == l));
    (!twice && labels.len() as u64 == columns && rows > 0).then_some(labels)
}

/// The columns of a matrix, named by its labels or, without labels, `name[0]`, `name[1]` and so on.
fn split(
    variable: &str,
    name: &str,
    (rows, columns): (u64, u64),
    values: Option<ColumnValues>,
    labels: Option<Vec<String>>,
) -> Vec<MatColumn> {
    // One channel per row.
    let across = labels.is_none() && columns > MOST_COLUMNS && rows <= MOST_CHANNELS;
    let (samples, channels) = if across { (columns, rows) } else { (rows, columns) };
    if channels > MOST_COLUMNS.max(labels.as_ref().map_or(0, |l| l.len() as u64)) {
        return vec![];
    }
    let of = |i: u64| {
        let (start, step) = if across { (i, rows) } else { (i * rows, 1) };
        values.as_ref().map(|v| strided(v, start as usize, step as usize, samples as usize))
    };
    let column = |i: u64| MatColumn {
        name: labels.as_ref().and_then(|l| l.get(i as usize).cloned()).unwrap_or_else(|| format!("{name}[{i}]")),
        rows: samples,
        variable: variable.to_owned(),
        values: of(i),
    };
    (0..channels).map(column).collect()
}

fn strided(values: &ColumnValues, start: usize, step: usize, count: usize) -> ColumnValues {
    fn of<T: Clone>(x: &[T], start: usize, step: usize, count: usize) -> Vec<T> {
        x.iter().skip(start).step_by(step.max(1)).take(count).cloned().collect()
    }
    match values {
        ColumnValues::Number(x) => ColumnValues::Number(of(x, start, step, count)),
        ColumnValues::Whole(x) => ColumnValues::Whole(of(x, start, step, count)),
        ColumnValues::Text(x) => ColumnValues::Text(of(x, start, step, count)),
    }
}

/// The columns of a structure; those of nested structures are named `a.b`.
fn flatten(variable: &str, prefix: &str, fields: Vec<MatVariable>, to: &mut Vec<MatColumn>) {
    for MatVariable { name, content } in fields {
        let name = format!("{prefix}{name}");
        match content {
            MatValue::Array { rows, columns, values } if rows == 1 || columns == 1 => {
                to.push(MatColumn { name, rows: rows.saturating_mul(columns), variable: variable.to_owned(), values });
            }
            MatValue::Array { rows, columns, values } => {
                to.extend(split(variable, &name, (rows, columns), values, None))
            }
            MatValue::Texts(texts) => {
                let rows = texts.len() as u64;
                to.push(MatColumn {
                    name,
                    rows,
                    variable: variable.to_owned(),
                    values: Some(ColumnValues::Text(texts)),
                });
            }
            MatValue::Struct(fields) => flatten(variable, &format!("{name}."), fields, to),
            MatValue::Skipped(_) => {}
        }
    }
}

/// Groups columns by their length. The group with the most columns has the plain name; a group of single values has it
/// only if there is no other group.
fn group(name: &str, columns: Vec<MatColumn>) -> Vec<MatTable> {
    let mut by_rows: BTreeMap<u64, Vec<MatColumn>> = BTreeMap::new();
    for column in columns.into_iter().filter(|c| c.rows > 0) {
        by_rows.entry(column.rows).or_default().push(column);
    }
    let most = by_rows.iter().max_by_key(|(rows, columns)| (**rows > 1, columns.len(), **rows)).map(|(rows, _)| *rows);
    let draft = |(rows, columns): (u64, Vec<MatColumn>)| {
        let name = if Some(rows) == most { name.to_owned() } else { format!("{name}:{rows}") };
        MatTable { name, rows, columns }
    };
    let (first, others): (Vec<_>, Vec<_>) = by_rows.into_iter().partition(|(rows, _)| Some(*rows) == most);
    first.into_iter().chain(others).map(draft).collect()
}
