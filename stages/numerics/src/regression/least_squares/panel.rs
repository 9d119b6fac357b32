//! Triangular factor of a tall matrix, processed one panel of rows at a time.
//!
//! Householder reflections eliminate a panel below the current triangle: the QR factorisation of [R; panel]. The outer
//! loop runs over rows and the inner loop over columns, eight to a cache line. Every sum over the rows is therefore in
//! row order for any processor, vector width and number of threads. A single pass over the panel applies one reflection
//! and forms the inner products of the next reflection.

/// Number of columns that are processed together: one cache line.
const LANES: usize = 8;

/// Rows of a panel: with 24 columns it fills the first-level cache.
pub(super) const PANEL: usize = 192;

#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
struct PanelLanes([f64; LANES]);

const ZERO: PanelLanes = PanelLanes([0.0; LANES]);

/// Upper triangle of a QR factorisation, and the rows that are not yet eliminated.
#[derive(Debug, Clone)]
pub(super) struct QrTriangle {
    width: usize,
    /// Number of columns that are eliminated. The other columns (carried columns) are only transformed.
    pivots: usize,
    /// Residual sum of squares of each carried column.
    squares: Vec<f64>,
    /// Panel of [`PANEL`] rows and 8 `blocks` columns, stored in blocks of eight columns.
    panel: Vec<PanelLanes>,
    filled: usize,
    /// Triangle of `pivots` rows and 8 `blocks` columns.
    r: Vec<PanelLanes>,
    reflector: Vec<f64>,
    next_reflector: Vec<f64>,
    dots: Vec<PanelLanes>,
    steps: Vec<PanelLanes>,
}

impl QrTriangle {
    /// Creates an empty triangle for a matrix of `pivots` columns with `carried` further columns.
    ///
    /// The result for a carried column is bit-identical whichever other columns are carried.
    pub(super) fn new(pivots: usize, carried: usize) -> Self {
        let width = pivots + carried;
        let blocks = width.div_ceil(LANES);
        Self {
            width,
            pivots,
            squares: vec![0.0; carried],
            panel: vec![ZERO; blocks * PANEL],
            filled: 0,
            r: vec![ZERO; blocks * pivots],
            reflector: vec![0.0; PANEL],
            next_reflector: vec![0.0; PANEL],
            dots: vec![ZERO; blocks],
            steps: vec![ZERO; blocks],
        }
    }

    /// Adds one row of `width` entries, or of [`padded`](Self::padded) entries padded with zeros.
    #[inline]
    pub(super) fn push(&mut self, row: &[f64]) {
        let (whole, rest) = row.as_chunks::<LANES>();
        let slots = self.panel.iter_mut().skip(self.filled).step_by(PANEL);
        let mut last = [0.0; LANES];
        last[..rest.len()].copy_from_slice(rest);
        for (slot, values) in slots.zip(whole.iter().chain(std::iter::once(&last))) {
            slot.0 = *values;
        }
        self.filled += 1;
        if self.filled == PANEL {
            self.flush();
        }
    }

    /// The width rounded up to whole cache lines.
    pub(super) fn padded(&self) -> usize {
        self.dots.len() * LANES
    }

    /// Eliminates the pending rows.
    pub(super) fn flush(&mut self) {
        if self.filled > 0 {
            pulp::Arch::new().dispatch(PanelElimination(self));
            self.filled = 0;
        }
    }

    /// The residual sum of squares of each carried column.
    pub(super) fn squares(&self) -> &[f64] {
        &self.squares
    }

    /// Adds `squares` to the residual sums of squares of the carried columns.
    pub(super) fn add_squares(&mut self, squares: &[f64]) {
        self.squares.iter_mut().zip(squares).for_each(|(sum, more)| *sum += more);
    }

    /// The same triangle with only the carried columns in `chosen`, in that order.
    pub(super) fn select(mut self, chosen: &[usize]) -> Self {
        self.flush();
        let mut out = Self::new(self.pivots, chosen.len());
        let (from, to) = (self.dots.len(), out.dots.len());
        let columns: Vec<usize> = (0..self.pivots).chain(chosen.iter().map(|c| self.pivots + c)).collect();
        for row in 0..self.pivots {
            for (k, &column) in columns.iter().enumerate() {
                let value = self.r[row * from + column / LANES].0[column % LANES];
                out.r[row * to + k / LANES].0[k % LANES] = value;
            }
        }
        out.squares = chosen.iter().map(|&c| self.squares[c]).collect();
        out
    }

    /// Triangle and carried columns, row-major `pivots` by `width`, with zeros below the diagonal.
    pub(super) fn upper(mut self) -> Vec<f64> {
        self.flush();
        let blocks = self.dots.len();
        let mut out = Vec::with_capacity(self.pivots * self.width);
        for (j, row) in self.r.chunks_exact(blocks).enumerate() {
            let row = row.iter().flat_map(|lanes| lanes.0).take(self.width);
            out.extend(row.enumerate().map(|(k, value)| if k < j { 0.0 } else { value }));
        }
        out
    }
}

/// The elimination, compiled for the vector width of each processor.
struct PanelElimination<'a>(&'a mut QrTriangle);

impl pulp::NullaryFnOnce for PanelElimination<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let triangle = self.0;
        first_dots(triangle);
        for column in 0..triangle.pivots {
            reflect_top(triangle, column);
            if column + 1 < triangle.width {
                reflect_panel(triangle, column);
            }
        }
        for carried in 0..triangle.squares.len() {
            let column = triangle.pivots + carried;
            let (from, lane) = (column / LANES * PANEL, column % LANES);
            let rows = &triangle.panel[from..from + triangle.filled];
            triangle.squares[carried] += rows.iter().map(|row| row.0[lane] * row.0[lane]).sum::<f64>();
        }
    }
}

/// The first column, and its inner products with all columns.
#[inline(always)]
fn first_dots(t: &mut QrTriangle) {
    for (v, row) in t.reflector.iter_mut().zip(&t.panel[..t.filled]) {
        *v = row.0[0];
    }
    let v = &t.reflector[..t.filled];
    let zeros = &t.next_reflector[..t.filled];
    for (block, rows) in t.panel.chunks_exact_mut(PANEL).enumerate() {
        t.dots[block] = update(&mut rows[..t.filled], zeros, &ZERO, v);
    }
}

/// Applies the reflection of `column` to its row of the triangle. Computes the multiple of the reflector that is
/// subtracted from each later column of the panel.
#[inline(always)]
fn reflect_top(t: &mut QrTriangle, column: usize) {
    let blocks = t.dots.len();
    let top = &mut t.r[column * blocks..(column + 1) * blocks];
    let (block, lane) = (column / LANES, column % LANES);
    let (alpha, below) = (top[block].0[lane], t.dots[block].0[lane]);
    t.steps.fill(ZERO);
    if below == 0.0 {
        return;
    }
    let norm = (alpha * alpha + below).sqrt();
    let beta = -norm.copysign(alpha);
    let head = alpha - beta;
    let half_square = norm * (norm + alpha.abs());
    for k in column + 1..blocks * LANES {
        let (block, lane) = (k / LANES, k % LANES);
        let step = (head * top[block].0[lane] + t.dots[block].0[lane]) / half_square;
        top[block].0[lane] -= head * step;
        t.steps[block].0[lane] = step;
    }
    top[block].0[lane] = beta;
}

/// Applies the reflection of `column` to the panel and forms the inner products of the next reflection.
#[inline(always)]
fn reflect_panel(t: &mut QrTriangle, column: usize) {
    let (from, lane) = ((column + 1) / LANES, (column + 1) % LANES);
    let step = t.steps[from].0[lane];
    let rows = &t.panel[from * PANEL..from * PANEL + t.filled];
    let reflectors = t.reflector.iter().zip(&mut t.next_reflector);
    for ((v, next), row) in reflectors.zip(rows) {
        *next = (-v).mul_add(step, row.0[lane]);
    }
    let (v, next) = (&t.reflector[..t.filled], &t.next_reflector[..t.filled]);
    for (block, rows) in t.panel.chunks_exact_mut(PANEL).enumerate().skip(from) {
        t.dots[block] = update(&mut rows[..t.filled], v, &t.steps[block], next);
    }
    std::mem::swap(&mut t.reflector, &mut t.next_reflector);
}

/// Subtracts `v` times `steps` from eight columns, and returns the inner products of these columns with `next`.
#[inline(always)]
fn update(rows: &mut [PanelLanes], v: &[f64], steps: &PanelLanes, next: &[f64]) -> PanelLanes {
    // Two sums, over even and odd rows, keep the adders busy; their order is fixed.
    let mut sums = [ZERO, ZERO];
    let mut pairs = rows.chunks_exact_mut(2);
    let (mut vs, mut nexts) = (v.chunks_exact(2), next.chunks_exact(2));
    for ((rows, v), next) in (&mut pairs).zip(&mut vs).zip(&mut nexts) {
        for parity in 0..2 {
            update_row(&mut rows[parity], v[parity], steps, next[parity], &mut sums[parity]);
        }
    }
    let rest = pairs.into_remainder().iter_mut();
    for ((row, v), next) in rest.zip(vs.remainder()).zip(nexts.remainder()) {
        update_row(row, *v, steps, *next, &mut sums[0]);
    }
    let mut dots = sums[0];
    for (dot, odd) in dots.0.iter_mut().zip(&sums[1].0) {
        *dot += odd;
    }
    dots
}

#[inline(always)]
fn update_row(row: &mut PanelLanes, v: f64, steps: &PanelLanes, next: f64, sum: &mut PanelLanes) {
    for lane in 0..LANES {
        let value = (-v).mul_add(steps.0[lane], row.0[lane]);
        row.0[lane] = value;
        sum.0[lane] = next.mul_add(value, sum.0[lane]);
    }
}
