//! Spatial index of earlier samples.

use std::collections::HashMap;

/// Samples by cells of a square grid. A full cell accepts no more samples: another flight over the cell adds little to
/// the map, and the cost of a look-up remains bounded.
#[derive(Clone, Debug)]
pub struct SlamSampleIndex {
    cell_m: f64,
    most: usize,
    cells: HashMap<(i64, i64), Vec<u32>>,
    places: Vec<(u32, [f64; 2])>,
}

impl SlamSampleIndex {
    /// Index with cells of this size, in metres, and a maximum number of samples per cell.
    pub fn new(cell_m: f64, most: usize) -> Self {
        Self { cell_m, most, cells: HashMap::new(), places: vec![] }
    }

    fn cell(&self, at_m: [f64; 2]) -> (i64, i64) {
        let [north, east] = at_m.map(|x| (x / self.cell_m).floor() as i64);
        (north, east)
    }

    /// Inserts a sample at a position north and east, in metres. Returns whether the cell of the sample accepted it.
    pub fn insert(&mut self, sample: u32, at_m: [f64; 2]) -> bool {
        let cell = self.cell(at_m);
        let members = self.cells.entry(cell).or_default();
        let room = members.len() < self.most;
        if room {
            members.push(self.places.len() as u32);
            self.places.push((sample, at_m));
        }
        room
    }

    /// Appends the samples within a radius to `found`, in the order in which they were inserted.
    pub fn within(&self, at_m: [f64; 2], radius_m: f64, found: &mut Vec<u32>) {
        let near =
            |[north, east]: [f64; 2]| (north - at_m[0]).powi(2) + (east - at_m[1]).powi(2) <= radius_m * radius_m;
        let (low, high) = (self.cell(at_m.map(|x| x - radius_m)), self.cell(at_m.map(|x| x + radius_m)));
        let side = |low: i64, high: i64| high.saturating_sub(low) as f64 + 1.0;
        if side(low.0, high.0) * side(low.1, high.1) > self.places.len() as f64 {
            found.extend(self.places.iter().filter(|(_, place)| near(*place)).map(|(sample, _)| *sample));
            return;
        }
        let first = found.len();
        for north in low.0..=high.0 {
            for east in low.1..=high.1 {
                let members = self.cells.get(&(north, east)).into_iter().flatten();
                found.extend(members.filter(|member| near(self.places[**member as usize].1)));
            }
        }
        let mine = found.get_mut(first..).unwrap_or_default();
        mine.sort_unstable();
        for member in mine {
            *member = self.places[*member as usize].0;
        }
    }
}
