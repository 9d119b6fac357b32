//! Work that recurses as deep as its input is nested, on a stack that is large enough for it.

use std::{ops::ControlFlow, panic::resume_unwind, thread};

use datafusion::sql::sqlparser::ast::{Expr, Select, TableFactor, Visit, Visitor};
use schemas::Fault;

/// Address space, not memory: a page is taken when it is first touched.
pub const STACK: usize = 1 << 30;
/// A text of SQL longer than this is rejected. Together with [`STACK`] it bounds every recursion over it.
const LONGEST: usize = 1 << 20;
/// A text of SQL up to this length is nested too little to need more than an ordinary stack.
const SHORT: usize = 2_000;
/// Number of brackets up to which an ordinary stack suffices. Thirty nested functions exceed a thread's stack of 2 MB.
const BRACKETS: usize = 8;

/// Runs `work`, which recurses over `sql`.
///
/// # Errors
/// Fails when the text is too long, or there is no memory for the stack.
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
/// Fails when there is no memory for it.
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

/// A query may be nested this deep; the time to plan it grows with the square and more.
pub const QUERY: usize = 1_000;
/// The same for an expression, before its chains of `and` and `or` are balanced.
pub const PREDICATE: usize = 5_000;
/// More tables and queries than this in one text are rejected too: each is a level of the plan.
const MOST_PARTS: usize = 1_000;

/// The fault of SQL that is nested too deep.
pub fn too_deep() -> Fault {
    Fault::new("the SQL is nested too deep")
        .help("write `x in (1, 2, 3)` for a chain of comparisons, and shorter sums and fewer brackets")
}

/// Rejects parsed SQL that is nested deeper than `deepest`; a chain `a or b or c` is a level for each of its terms.
///
/// # Errors
/// Fails when it is nested deeper.
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
        let fault = Fault::new(format!("the SQL has more than {MOST_PARTS} tables and queries; split it"));
        ControlFlow::Break(Box::new(fault.help("ask several questions")))
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
