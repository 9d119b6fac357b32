//! Limits on the size of values: rejects expressions whose values may be much larger than their inputs, so that an
//! untrusted spec cannot exhaust memory.

use arrow_schema::DataType;
use datafusion::{
    common::{
        DFSchema, ScalarValue,
        tree_node::{TreeNode, TreeNodeRecursion},
    },
    logical_expr::{BinaryExpr, Expr, ExprSchemable, Operator, expr::ScalarFunction},
};
use schemas::Fault;

/// Number of rows that are evaluated together if values are strings.
pub const ROWS: usize = 4096;
/// Maximum length of a string in an expression, in bytes.
const LONGEST: usize = 1000;
/// Maximum number of concatenations in an expression.
const JOINED: usize = 20;

/// Text functions and conditional expressions whose value is at most as long as all arguments together.
const BOUNDED: [&str; 26] = [
    "btrim",
    "chr",
    "coalesce",
    "concat",
    "concat_ws",
    "greatest",
    "initcap",
    "least",
    "left",
    "lower",
    "ltrim",
    "md5",
    "nullif",
    "nvl",
    "nvl2",
    "reverse",
    "right",
    "rtrim",
    "split_part",
    "substr",
    "substring",
    "to_char",
    "to_hex",
    "translate",
    "trim",
    "upper",
];

/// Rejects expressions whose values may be much larger than their columns.
///
/// # Errors
/// Fails for such an expression. The fault names the function, the string or the number of concatenations.
pub fn check(expr: &Expr, schema: &DFSchema, subject: &str) -> Result<(), Fault> {
    let (mut found, mut joined) = (None, 0);
    let visited = expr.apply(|e| {
        let is_join = match e {
            Expr::BinaryExpr(BinaryExpr { op, .. }) => *op == Operator::StringConcat,
            Expr::ScalarFunction(f) => matches!(f.name(), "concat" | "concat_ws"),
            _ => false,
        };
        joined += usize::from(is_join);
        let what = match e {
            Expr::ScalarFunction(f) if grows(f, e, schema) => Some(format!("the function `{}`", f.name())),
            Expr::HigherOrderFunction(_) | Expr::Lambda(_) => Some("a function of lists".to_owned()),
            Expr::Literal(value, _) if length(value) > LONGEST => Some(format!("a text of more than {LONGEST} bytes")),
            _ if joined > JOINED => Some(format!("more than {JOINED} concatenations")),
            _ => None,
        };
        found = what;
        Ok(if found.is_some() { TreeNodeRecursion::Stop } else { TreeNodeRecursion::Continue })
    });
    visited.map_err(|e| Fault::new(format!("{subject} cannot be read: {e}")))?;
    found.map_or(Ok(()), |what| {
        let fault = Fault::new(format!("{subject} uses {what}, whose result may not fit in memory"));
        Err(fault.help("compare columns with values, or use numeric functions"))
    })
}

/// The length of a string.
fn length(value: &ScalarValue) -> usize {
    value.try_as_str().flatten().map_or(0, str::len)
}

fn text(expr: Option<&Expr>) -> Option<&str> {
    match expr? {
        Expr::Literal(value, _) => value.try_as_str().flatten(),
        _ => None,
    }
}

fn grows(function: &ScalarFunction, expr: &Expr, schema: &DFSchema) -> bool {
    let name = function.name();
    let args = &function.args;
    if BOUNDED.contains(&name) {
        return false;
    }
    match name {
        "arrow_cast" => text(args.get(1)).is_none_or(|kind| kind.contains("Fixed") || kind.contains("List")),
        "replace" => match (text(args.get(1)), text(args.get(2))) {
            (Some(from), Some(to)) => from.is_empty() || to.len() > from.len(),
            _ => true,
        },
        "regexp_replace" => text(args.get(2)).is_none_or(|to| !to.is_empty()),
        // An expression whose type cannot be determined is rejected later.
        _ => expr.get_type(schema).is_ok_and(|kind| {
            let small = kind.is_numeric() || kind.is_temporal() || matches!(kind, DataType::Boolean | DataType::Null);
            !small
        }),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use schemas::{Column, TableShape};

    use crate::Expression;

    #[test]
    fn unit_potentially_large_values_are_rejected_before_evaluation() {
        let shape =
            TableShape { columns: vec![Column::text("line", ""), Column::float("a", "nT", "")].into(), rate_hz: None };
        let read = |sql: &str| Expression::new(sql, &shape, "`x`").map_err(|fault| fault.to_string());
        for sql in [
            "length(repeat('a', 2000000000)) + a",
            "length(repeat(arrow_cast(a, 'Utf8'), 1000000)) + a",
            "length(lpad('a', 2000000000))",
            "length(rpad(line, 1000000))",
            "array_length(range(0, 1000000000))",
            "array_length(generate_series(0, 1000000000))",
            "array_length(array_repeat(a, 1000000000))",
            "length(replace(line, '1', 'aaaaaaaaaaaaaaaaaaaa'))",
            "length(replace(line, '', 'a'))",
            "length(regexp_replace(line, '', 'aaaa', 'g'))",
            "length(encode(line, 'hex'))",
            "length(array_to_string(string_to_array(line, NULL), 'aaaaaaaaaa'))",
            "array_length(make_array(a, a))",
        ] {
            let message = read(sql).unwrap_err();
            assert!(message.contains("may not fit in memory"), "{sql}: {message}");
        }
        let many = vec!["line"; 40].join(" || ");
        assert!(read(&format!("length({many})")).unwrap_err().contains("concatenations"));
        assert!(read(&format!("length('{}')", "a".repeat(2000))).unwrap_err().contains("bytes"));
        for sql in [
            "cast(replace(line, 'L', '') as double)",
            "length(lower(line) || '.01')",
            "cast(split_part(line, '.', 2) as double) + a",
            "length(regexp_replace(line, '[A-Z]', ''))",
            "strpos(line, '.')",
            "power(10, 3) * a",
        ] {
            assert!(read(sql).is_ok(), "{sql}: {:?}", read(sql).err());
        }
    }
}
