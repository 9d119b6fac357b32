//! Cast of a column to another type without loss.

use std::sync::Arc;

use arrow_array::{Array, ArrayRef, FixedSizeListArray, cast::AsArray};
use arrow_schema::{DataType, FieldRef};

use crate::Fault;

/// Casts `array` to `kind`.
///
/// Arrow's cast of lists to fixed-size lists is wrong for a slice: it reads from the start of the underlying array.
/// That cast is therefore implemented here.
///
/// # Errors
/// Fails if `kind` cannot represent a value, or if a list has another length.
pub fn cast(array: &ArrayRef, kind: &DataType) -> Result<ArrayRef, Fault> {
    match (array.data_type(), kind) {
        (from, to) if from == to => Ok(array.clone()),
        (DataType::List(_), DataType::FixedSizeList(item, n)) => fixed(array, item, *n),
        _ => arrow_cast::cast(array, kind).map_err(|e| Fault::machine(e.to_string())),
    }
}

/// Casts to fixed-size lists.
fn fixed(array: &ArrayRef, item: &FieldRef, n: i32) -> Result<ArrayRef, Fault> {
    let wrong = || Fault::bug(format!("a list does not have {n} entries"));
    let lists = array.as_list_opt::<i32>().ok_or_else(wrong)?;
    let offsets = lists.value_offsets();
    let (first, last) = (offsets.first().copied().unwrap_or(0), offsets.last().copied().unwrap_or(0));
    if offsets.windows(2).any(|w| w[1] - w[0] != n) {
        return Err(wrong());
    }
    let values = lists.values().slice(first as usize, (last - first) as usize);
    let values = if values.data_type() == item.data_type() { values } else { return Err(wrong()) };
    FixedSizeListArray::try_new(item.clone(), n, values, lists.nulls().cloned())
        .map(|array| Arc::new(array) as ArrayRef)
        .map_err(|e| Fault::machine(e.to_string()))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use arrow_array::{ListArray, types::Float64Type};
    use arrow_schema::Field;

    use super::*;

    #[test]
    fn unit_slices_of_lists_keep_their_values() {
        let item = Arc::new(Field::new("item", DataType::Float64, false));
        let rows =
            [0..3, 3..6, 6..8, 8..10, 10..12].map(|row| Some(row.map(|x| Some(f64::from(x))).collect::<Vec<_>>()));
        let lists: ArrayRef = Arc::new(ListArray::from_iter_primitive::<Float64Type, _, _>(rows));
        let of = |first: usize, rows: usize, n: i32| {
            let made = cast(&lists.slice(first, rows), &DataType::FixedSizeList(item.clone(), n))?;
            Ok::<_, Fault>(made.as_fixed_size_list().values().as_primitive::<Float64Type>().values().to_vec())
        };
        assert_eq!(of(0, 2, 3).unwrap(), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
        assert_eq!(of(3, 2, 2).unwrap(), [8.0, 9.0, 10.0, 11.0]);
        assert!(of(1, 2, 3).unwrap_err().what.contains("a list does not have 3 entries"));
    }
}
