//! Recursive work on nested input, on a sufficiently large stack.

use std::{ops::ControlFlow, panic::resume_unwind, thread};

use datafusion::sql::sqlparser::ast::{Expr, Select, TableFactor, Visit, Visitor};
use schemas::Fault;

/// Size of the large stack, in bytes. Only address space is reserved: a page uses no memory before its first access.
pub const STACK: usize = 1 << 30;
/// Maximum length of an SQL text, in bytes. Together with [`STACK`] it limits every recursion over the text.
const LONGEST: usize = 1 << 20;
/// An ordinary stack suffices for an SQL text up to this length, in bytes.
const SHORT: usize = 2_000;
/// An ordinary stack suffices for an SQL text with at most this number of opening brackets. Thirty nested functions
/// exceed a thread's stack of 2 MB.
const BRACKETS: usize = 8;

/// Runs `work`, which recurses over `sql`.
///
/// # Errors
/// Fails if the text is too long or the stack cannot be allocated.
pub fn over<T: Send>(sql: &str, work: impl FnOnce() -> T + Send) -> Result<T, Fault> {
    if sql.len() > LONGEST {
        let what = format!("the SQL is {} bytes long; the limit is {LONGEST} bytes", sql.len());
        return Err(Fault::new(what).help("put long lists of values into a table"));
    }
    let flat = sql.len() <= SHORT && sql.matches('(').count() <= BRACKETS;
    if flat { Ok(work()) } else { deep(work) }
}

/// Runs `work` on a thread with a large stack.
///
/// # Errors
/// Fails if the stack cannot be allocated.
pub fn deep<T: Send>(work: impl FnOnce() -> T + Send) -> Result<T, Fault> {
    thread::scope(|scope| {
        let thread = thread::Builder::new().stack_size(STACK).spawn_scoped(scope, work);
        let thread = thread.map_err(|e| Fault::machine(format!("cannot start a thread: {e}")))?;
        match thread.join() {
            Ok(done) => Ok(done),
            Err(panic) => resume_unwind(panic),
        }
    })
}

/// Maximum nesting depth of a query. Planning time grows at least with its square.
pub const QUERY: usize = 1_000;
/// Maximum nesting depth of an expression, before its chains of `and` and `or` are balanced.
pub const PREDICATE: usize = 5_000;
/// Maximum number of tables and queries in one text; each is a level of the plan.
const MOST_PARTS: usize = 1_000;

/// The fault of SQL that is nested too deeply.
pub fn too_deep() -> Fault {
    Fault::new("the SQL is nested too deeply")
        .help("replace a chain of comparisons by `x in (1, 2, 3)`, split long sums, and remove brackets")
}

/// Rejects parsed SQL that is nested more deeply than `deepest`. A chain `a or b or c` has one level per term.
///
/// # Errors
/// Fails if the SQL is nested more deeply.
pub fn check(tree: &impl Visit, deepest: usize) -> Result<(), Fault> {
    let mut depth = DepthLimiter { deepest, now: 0, parts: 0 };
    match tree.visit(&mut depth) {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(fault) => Err(*fault),
    }
}

struct DepthLimiter {
    deepest: usize,
    now: usize,
    parts: usize,
}

impl DepthLimiter {
    fn part(&mut self) -> ControlFlow<Box<Fault>> {
        self.parts += 1;
        if self.parts <= MOST_PARTS {
            return ControlFlow::Continue(());
        }
        let fault = Fault::new(format!("the SQL has more than {MOST_PARTS} tables and queries"));
        ControlFlow::Break(Box::new(fault.help("split the SQL into several queries")))
    }
}

impl Visitor for DepthLimiter {
    type Break = Box<Fault>;

    fn pre_visit_expr(&mut self, _: &Expr) -> ControlFlow<Self::Break> {
        self.now += 1;
        if self.now > self.deepest { ControlFlow::Break(Box::new(too_deep())) } else { ControlFlow::Continue(()) }
    }

    fn post_visit_expr(&mut self, _: &Expr) -> ControlFlow<Self::Break> {
        self.now -= 1;
        ControlFlow::Continue(())
    }

    fn pre_visit_select(&mut self, _: &Select) -> ControlFlow<Self::Break> {
        self.part()
    }

    fn pre_visit_table_factor(&mut self, _: &TableFactor) -> ControlFlow<Self::Break> {
        self.part()
    }
}
