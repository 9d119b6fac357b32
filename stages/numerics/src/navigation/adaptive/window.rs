//! Sum of the last numbers of a series.

use crate::navigation::stream::StateVisitor;

/// Last numbers of a series, and the sum of these numbers. The sum uses no subtraction, so removed numbers leave no
/// rounding error. The average cost per number is constant.
#[derive(Clone)]
pub(super) struct SlidingSum {
    /// Ring buffer: entries before `next` belong to the present round, the others to the previous round.
    numbers: Vec<f64>,
    next: usize,
    len: usize,
    /// Sum of the present round.
    round: f64,
    /// Sums of the previous round from each index to the end of the buffer.
    before: Vec<f64>,
}

impl SlidingSum {
    /// Empty window over the last `capacity` numbers; `capacity` is at least 1.
    pub(super) fn new(capacity: usize) -> Self {
        Self { numbers: vec![0.0; capacity], next: 0, len: 0, round: 0.0, before: vec![0.0; capacity + 1] }
    }

    /// Number of values.
    pub(super) fn len(&self) -> usize {
        self.len
    }

    /// Maximum number of values.
    pub(super) fn capacity(&self) -> usize {
        self.numbers.len()
    }

    /// Sum of the numbers in the window.
    pub(super) fn sum(&self) -> f64 {
        self.round + self.before[self.next]
    }

    /// Visits the window.
    pub(super) fn visit(&mut self, state: &mut dyn StateVisitor) {
        let capacity = self.numbers.len();
        state.numbers(&mut self.numbers);
        state.numbers(&mut self.before);
        state.number(&mut self.round);
        state.count(&mut self.next, capacity - 1);
        state.count(&mut self.len, capacity);
    }

    /// Adds a number, and drops the oldest of a full window.
    pub(super) fn push(&mut self, number: f64) {
        self.numbers[self.next] = number;
        self.round += number;
        self.next += 1;
        self.len = (self.len + 1).min(self.numbers.len());
        if self.next == self.numbers.len() {
            for (place, number) in self.numbers.iter().enumerate().rev() {
                self.before[place] = self.before[place + 1] + number;
            }
            self.next = 0;
            self.round = 0.0;
        }
    }
}
