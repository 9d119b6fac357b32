//! Columns of a table that share memory with equal columns of other tables.

use std::{iter::Map, ops::Index, slice::Iter, sync::Arc};

use crate::Column;

/// Columns in the order of their table.
///
/// Most stages of a plan pass most columns on to the next table. A copy of the list shares its columns, so each column
/// that is passed on costs one pointer. Two lists are equal if their columns have equal values.
#[derive(Clone, Debug, Default)]
pub struct ColumnList(Vec<Arc<Column>>);

impl ColumnList {
    /// The columns.
    pub fn iter(&self) -> <&ColumnList as IntoIterator>::IntoIter {
        self.into_iter()
    }

    /// The columns as shared pointers.
    pub fn shared(&self) -> &[Arc<Column>] {
        &self.0
    }

    /// The number of columns.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether the table has no columns.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Appends a column.
    pub fn push(&mut self, column: Column) {
        self.0.push(Arc::new(column));
    }
}

impl PartialEq for ColumnList {
    fn eq(&self, other: &ColumnList) -> bool {
        let same = |(one, other): (&Arc<Column>, &Arc<Column>)| Arc::ptr_eq(one, other) || one == other;
        self.len() == other.len() && self.0.iter().zip(&other.0).all(same)
    }
}

impl Index<usize> for ColumnList {
    type Output = Column;

    fn index(&self, at: usize) -> &Column {
        &self.0[at]
    }
}

impl<'a> IntoIterator for &'a ColumnList {
    type Item = &'a Column;
    type IntoIter = Map<Iter<'a, Arc<Column>>, fn(&'a Arc<Column>) -> &'a Column>;

    fn into_iter(self) -> Self::IntoIter {
        self.0.iter().map(AsRef::as_ref)
    }
}

impl FromIterator<Column> for ColumnList {
    fn from_iter<I: IntoIterator<Item = Column>>(columns: I) -> ColumnList {
        columns.into_iter().map(Arc::new).collect()
    }
}

impl FromIterator<Arc<Column>> for ColumnList {
    fn from_iter<I: IntoIterator<Item = Arc<Column>>>(columns: I) -> ColumnList {
        ColumnList(columns.into_iter().collect())
    }
}

impl From<Vec<Column>> for ColumnList {
    fn from(columns: Vec<Column>) -> ColumnList {
        columns.into_iter().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_lists_share_columns_and_are_equal_by_value() {
        let made = || vec![Column::float("mag_1_c", "nT", "a"), Column::text("line", "b")];
        let (one, other) = (ColumnList::from(made()), ColumnList::from(made()));
        assert_eq!((&one, one.len(), one[1].name.as_str()), (&other, 2, "line"));
        let mut longer: ColumnList = one.shared().iter().cloned().collect();
        assert!(Arc::ptr_eq(&longer.shared()[0], &one.shared()[0]));
        longer.push(Column::float("tt", "s", ""));
        assert_ne!(longer, one);
        assert_ne!(ColumnList::from(vec![Column::float("mag_1_c", "nT", "other"), one[1].clone()]), one);
        assert_eq!(longer.iter().map(|c| c.name.as_str()).collect::<Vec<_>>(), ["mag_1_c", "line", "tt"]);
    }
}
