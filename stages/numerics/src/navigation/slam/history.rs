//! Paths of all particles, which share their past.
//!
//! A generation is the interval between two resamplings. For each of its particles with a living descendant it stores
//! the displacement at each sample; such a particle is a *slot*. The history also stores, for each present particle,
//! the slot of its ancestor. Two look-ups therefore give any earlier position of a particle. Resampling maps the
//! ancestors and drops the slots without descendants. Of two neighbouring generations, the older divides the present
//! particles into coarser families than the younger; if the families are equal, the two are merged. The number of
//! generations therefore never exceeds the number of particles. Where all particles have one ancestor, a single
//! displacement per sample is stored.

use std::ops::Range;

/// Horizontal displacement from the INS, north and east, in metres. Single precision resolves 1 mm at 10 km.
pub type Displacement = [f32; 2];

#[derive(Clone, Debug)]
struct ParticleGeneration {
    /// Samples of the generation.
    samples: Range<usize>,
    /// Number of particles of the generation that have living descendants.
    slots: usize,
    /// One displacement per sample and slot, by samples.
    displacements: Vec<Displacement>,
    /// Slot of the ancestor of each present particle.
    ancestors: Vec<u32>,
}

/// Displacements of all particles at all samples.
#[derive(Clone, Debug)]
pub struct ParticleHistory {
    particles: usize,
    generations: Vec<ParticleGeneration>,
    samples: usize,
    /// Whether the last generation accepts samples, that is, has not been resampled.
    open: bool,
}

/// Displacements of the ancestors of all particles at one sample.
#[derive(Clone, Copy, Debug)]
pub struct AncestorDisplacements<'a> {
    displacements: &'a [Displacement],
    ancestors: &'a [u32],
}

impl AncestorDisplacements<'_> {
    /// Displacement, in metres, of the ancestor of a particle.
    #[inline(always)]
    pub fn displacement(&self, particle: usize) -> [f64; 2] {
        let [north, east] = self.displacements[self.ancestors[particle] as usize];
        [f64::from(north), f64::from(east)]
    }
}

impl ParticleHistory {
    /// Empty history.
    pub fn new(particles: usize) -> Self {
        Self { particles, generations: vec![], samples: 0, open: false }
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.samples
    }

    /// Whether there are no samples.
    pub fn is_empty(&self) -> bool {
        self.samples == 0
    }

    /// Numbers of generations and of stored displacements.
    pub fn size(&self) -> (usize, usize) {
        (self.generations.len(), self.generations.iter().map(|generation| generation.displacements.len()).sum())
    }

    /// Appends a sample, with one displacement per particle.
    pub fn push(&mut self, displacements: impl Iterator<Item = Displacement>) {
        if !self.open {
            let (slots, samples) = (self.particles, self.samples..self.samples);
            let ancestors = (0..slots as u32).collect();
            self.generations.push(ParticleGeneration { samples, slots, displacements: vec![], ancestors });
            self.open = true;
        }
        if let Some(last) = self.generations.last_mut() {
            last.displacements.extend(displacements.take(self.particles));
            last.samples.end += 1;
            self.samples += 1;
        }
    }

    /// Looks up a sample; `None` beyond the last sample.
    pub fn at(&self, sample: usize) -> Option<AncestorDisplacements<'_>> {
        let place = self.generations.partition_point(|generation| generation.samples.end <= sample);
        let ParticleGeneration { samples, slots, displacements, ancestors } = self.generations.get(place)?;
        let first = (sample - samples.start) * slots;
        Some(AncestorDisplacements { displacements: &displacements[first..first + slots], ancestors })
    }

    /// Replaces each particle by a copy of its parent.
    pub fn resample(&mut self, parents: &[u32]) {
        self.open = false;
        let mut kept: Vec<ParticleGeneration> = Vec::with_capacity(self.generations.len());
        for mut generation in std::mem::take(&mut self.generations) {
            generation.map_on(parents);
            match kept.last_mut() {
                Some(older) if older.slots == generation.slots => older.append(generation),
                Some(_) | None => kept.push(generation),
            }
        }
        self.generations = kept;
    }
}

impl ParticleGeneration {
    /// Maps the ancestors, and keeps the remaining slots in the order of the particles.
    fn map_on(&mut self, parents: &[u32]) {
        const GONE: u32 = u32::MAX;
        let mut places = vec![GONE; self.slots];
        let mut left: Vec<u32> = vec![];
        let mut ancestors = Vec::with_capacity(parents.len());
        for parent in parents {
            let slot = self.ancestors[*parent as usize];
            let place = &mut places[slot as usize];
            if *place == GONE {
                *place = left.len() as u32;
                left.push(slot);
            }
            ancestors.push(*place);
        }
        self.ancestors = ancestors;
        let in_place = left.len() == self.slots && left.iter().enumerate().all(|(place, slot)| place == *slot as usize);
        if !in_place {
            self.displacements = self.of_slots(&left);
            self.slots = left.len();
        }
    }

    /// Displacements of a subset of slots.
    fn of_slots(&self, slots: &[u32]) -> Vec<Displacement> {
        let mut out = Vec::with_capacity(slots.len() * self.samples.len());
        for sample in self.displacements.chunks_exact(self.slots.max(1)) {
            out.extend(slots.iter().map(|slot| sample[*slot as usize]));
        }
        out
    }

    /// Appends the next generation, which has the same families.
    fn append(&mut self, younger: Self) {
        let mut order = vec![0; self.slots];
        for (ours, theirs) in self.ancestors.iter().zip(&younger.ancestors) {
            order[*ours as usize] = *theirs;
        }
        self.displacements.extend(younger.of_slots(&order));
        self.samples.end = younger.samples.end;
    }
}
