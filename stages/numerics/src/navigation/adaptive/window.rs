//! The sum of the last numbers of a series.

/// The last numbers, and their sum without the rounding of what has left: nothing is ever subtracted. Constant cost a
/// number on average.
pub(super) struct SlidingSum {
    /// In a ring: those before `next` are of the present round, the others of the round before.
    numbers: Vec<f64>,
    next: usize,
    len: usize,
    /// The sum of the present round.
    round: f64,
    /// Sums of the previous round from each place to its end.
    before: Vec<f64>,
}

impl SlidingSum {
    /// An empty window over the last `capacity` numbers, which is at least 1.
    pub(super) fn new(capacity: usize) -> Self {
        Self { numbers: vec![0.0; capacity], next: 0, len: 0, round: 0.0, before: vec![0.0; capacity + 1] }
    }

    /// Number of values.
    pub(super) fn len(&self) -> usize {
        self.len
    }

    /// Capacity.
    pub(super) fn capacity(&self) -> usize {
        self.numbers.len()
    }

    /// Their sum.
    pub(super) fn sum(&self) -> f64 {
        self.round + self.before[self.next]
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
