//! The allowed parts of an expression, and a form of it without deep nesting.
//!
//! `subject` is the name of the expression in faults, such as `` `where` ``.

use datafusion::{
    common::tree_node::{Transformed, TreeNode, TreeNodeRecursion},
    error::DataFusionError,
    logical_expr::{BinaryExpr, Expr, Operator, Volatility},
};
use schemas::Fault;

use crate::deep;

/// Maximum nesting depth of an expression. Worker threads evaluate it on ordinary stacks, which suffice for many times
/// this depth.
const DEEPEST: usize = 500;

/// Rejects expressions that are not a function of one row.
///
/// # Errors
/// Fails for clocks, random numbers, functions of several rows or tables, or variables.
pub fn check(expr: &Expr, subject: &str) -> Result<(), Fault> {
    let mut found = None;
    let visited = expr.apply(|e| {
        found = objection(e, subject);
        Ok(if found.is_some() { TreeNodeRecursion::Stop } else { TreeNodeRecursion::Continue })
    });
    visited.map_err(|e| Fault::new(format!("{subject} cannot be read: {e}")))?;
    found.map_or(Ok(()), Err)
}

fn objection(expr: &Expr, subject: &str) -> Option<Fault> {
    let rows = |name: &str| {
        let fault = Fault::new(format!("`{name}` requires several rows, but {subject} is evaluated row by row"));
        Some(fault.help("compare columns of the row with values"))
    };
    match expr {
        Expr::ScalarFunction(f) => match f.func.signature().volatility {
            Volatility::Immutable => None,
            Volatility::Stable | Volatility::Volatile => {
                let fault = Fault::new(format!("`{}()` gives a different value each time", f.name()));
                let help = format!("{subject} must depend on the row alone, so that a spec is reproducible");
                Some(fault.help(help))
            }
        },
        Expr::AggregateFunction(f) => rows(f.func.name()),
        Expr::WindowFunction(f) => rows(f.fun.name()),
        Expr::Exists(_) | Expr::InSubquery(_) | Expr::SetComparison(_) | Expr::ScalarSubquery(_) => {
            let fault = Fault::new(format!("{subject} cannot contain a query"));
            let values = "write the values out: `line in ('1003.02', '1003.04')`";
            Some(fault.help(format!("{subject} is evaluated on one row of one table; {values}")))
        }
        Expr::ScalarVariable(..) | Expr::Placeholder(_) => Some(
            Fault::new(format!("{subject} cannot use variables")).help("write `\"$axis\"` to use the value of an axis"),
        ),
        #[expect(deprecated)]
        Expr::Wildcard { .. } => Some(Fault::new(format!("{subject} cannot contain `*`"))),
        Expr::GroupingSet(_) | Expr::Unnest(_) | Expr::OuterReferenceColumn(..) => {
            Some(Fault::new(format!("{subject} is evaluated on one row of one table")))
        }
        Expr::Alias(_)
        | Expr::Column(_)
        | Expr::Literal(..)
        | Expr::BinaryExpr(_)
        | Expr::Like(_)
        | Expr::SimilarTo(_)
        | Expr::Not(_)
        | Expr::IsNotNull(_)
        | Expr::IsNull(_)
        | Expr::IsTrue(_)
        | Expr::IsFalse(_)
        | Expr::IsUnknown(_)
        | Expr::IsNotTrue(_)
        | Expr::IsNotFalse(_)
        | Expr::IsNotUnknown(_)
        | Expr::Negative(_)
        | Expr::Between(_)
        | Expr::Case(_)
        | Expr::Cast(_)
        | Expr::TryCast(_)
        | Expr::InList(_)
        | Expr::HigherOrderFunction(_)
        | Expr::Lambda(_)
        | Expr::LambdaVariable(_) => None,
    }
}

/// The expression with long chains of `and` and `or` as balanced trees, because SQL parses such chains as nested to the
/// left.
///
/// # Errors
/// Fails only if DataFusion cannot rewrite the expression.
pub fn balanced(expr: Expr) -> Result<Expr, DataFusionError> {
    /// Shorter chains are unchanged.
    const LONG: usize = 64;
    let rebuild = |e: Expr| {
        let Expr::BinaryExpr(BinaryExpr { op, .. }) = &e else { return Ok(Transformed::no(e)) };
        let op = *op;
        if !matches!(op, Operator::And | Operator::Or) || left_depth(&e, op) < LONG {
            return Ok(Transformed::no(e));
        }
        Ok(Transformed::yes(tree(chain(e, op), op)))
    };
    expr.transform_down(rebuild).map(|t| t.data)
}

fn left_depth(mut expr: &Expr, op: Operator) -> usize {
    let mut depth = 0;
    while let Expr::BinaryExpr(b) = expr
        && b.op == op
    {
        depth += 1;
        expr = &b.left;
    }
    depth
}

/// The terms of a chain, in order.
fn chain(expr: Expr, op: Operator) -> Vec<Expr> {
    let (mut terms, mut rest) = (vec![], vec![expr]);
    while let Some(e) = rest.pop() {
        match e {
            Expr::BinaryExpr(b) if b.op == op => {
                rest.push(*b.right);
                rest.push(*b.left);
            }
            term => terms.push(term),
        }
    }
    terms
}

fn tree(mut terms: Vec<Expr>, op: Operator) -> Expr {
    while terms.len() > 1 {
        let mut pairs = vec![];
        let mut each = terms.into_iter();
        while let Some(left) = each.next() {
            pairs.push(match each.next() {
                Some(right) => Expr::BinaryExpr(BinaryExpr::new(Box::new(left), op, Box::new(right))),
                None => left,
            });
        }
        terms = pairs;
    }
    terms.pop().unwrap_or_default()
}

/// Rejects expressions that are nested too deeply to be evaluated.
///
/// # Errors
/// Fails above 500 levels.
pub fn shallow(expr: &Expr, subject: &str) -> Result<(), Fault> {
    // Traversal level by level, because recursion over a large tree may overflow the stack.
    let mut level = vec![expr];
    for _ in 0..DEEPEST {
        let mut next = vec![];
        for e in level {
            let visited = e.apply_children(|child| {
                next.push(child);
                Ok(TreeNodeRecursion::Continue)
            });
            visited.map_err(|e| Fault::new(format!("{subject} cannot be read: {e}")))?;
        }
        if next.is_empty() {
            return Ok(());
        }
        level = next;
    }
    Err(deep::too_deep())
}
