//! The paths of all particles, which share their past.
//!
//! A generation is what lies between two resamplings. It stores the displacement of every one of its particles that
//! still has a descendant, a *slot*, at each sample, and for each particle of today the slot of its ancestor, so that
//! the earlier position of a particle is two look-ups away however long ago. Resampling maps the ancestors on and drops
//! the slots without descendants. The older of two neighbouring generations divides the particles of today into
//! coarser families than the younger; once the families are the same, the two become one generation. So there are never
//! more generations than particles, and where all particles have one ancestor, one displacement a sample is left.

use std::ops::Range;

/// A horizontal displacement from the INS, north and east, in m. Single precision is 1 mm at 10 km.
pub type Displacement = [f32; 2];

#[derive(Clone, Debug)]
struct ParticleGeneration {
    /// Its samples.
    samples: Range<usize>,
    /// Its particles that have descendants.
    slots: usize,
    /// A displacement a sample and slot, by samples.
    displacements: Vec<Displacement>,
    /// The slot of the ancestor of each particle of today.
    ancestors: Vec<u32>,
}

/// The displacements of all particles at all samples.
#[derive(Clone, Debug)]
pub struct ParticleHistory {
    particles: usize,
    generations: Vec<ParticleGeneration>,
    samples: usize,
    /// Whether the last generation takes samples: it has not been resampled.
    open: bool,
}

/// Displacements of the ancestors of all particles at one sample.
#[derive(Clone, Copy, Debug)]
pub struct AncestorDisplacements<'a> {
    displacements: &'a [Displacement],
    ancestors: &'a [u32],
}

impl AncestorDisplacements<'_> {
    /// The displacement, in m, of the ancestor of a particle.
    #[inline(always)]
    pub fn displacement(&self, particle: usize) -> [f64; 2] {
        let [north, east] = self.displacements[self.ancestors[particle] as usize];
        [f64::from(north), f64::from(east)]
    }
}

impl ParticleHistory {
    /// No sample yet.
    pub fn new(particles: usize) -> Self {
        Self { particles, generations: vec![], samples: 0, open: false }
    }

    /// The number of samples.
    pub fn len(&self) -> usize {
        self.samples
    }

    /// Whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.samples == 0
    }

    /// The number of generations, and of the displacements stored.
    pub fn size(&self) -> (usize, usize) {
        (self.generations.len(), self.generations.iter().map(|generation| generation.displacements.len()).sum())
    }

    /// Appends a sample, with a displacement for each particle.
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

    /// Looks up a sample; `None` beyond the last.
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
    /// Maps the ancestors on, and keeps the slots that are left, in the order of the particles.
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

    /// The displacements of some slots.
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
