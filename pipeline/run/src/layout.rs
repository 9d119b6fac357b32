//! Layout of the units of a table in packs.
//!
//! The units have one order, given by the plan and the lines, and are divided into chunks of similar size. A chunk is
//! computed together and becomes one pack. The packs of a run thus do not depend on threads, on time or on the progress
//! of an earlier run that was killed. A growing sweep writes packs for the new units. When a table has too many packs,
//! they are merged, as `compact` does.

use std::{collections::HashMap, ops::Range};

use plan::{PlanGraph, PlanUnit};
use schemas::{Grain, keys::HashKey};
use store::{PackCatalogue, PackedUnit};

use super::cut::TableAssembler;

/// Size of a chunk in memory, in bytes.
const CHUNK_BYTES: usize = 8 << 20;
/// A chunk that holds at most this number of points, all of one line, may exceed this size, so that these points share
/// the computations of the line.
const POINTS_TOGETHER: usize = 8;

/// Units of a table in the order of its rows, in chunks.
pub struct TableLayout {
    /// Units, in order.
    pub units: Vec<PlanUnit>,
    /// Ranges of the chunks.
    pub chunks: Vec<Range<usize>>,
}

impl TableLayout {
    /// Layout of the table of `cut`.
    pub fn new(graph: &PlanGraph, table: usize, cut: &TableAssembler) -> TableLayout {
        let node = &graph.plan.tables[table];
        let mut units: Vec<PlanUnit> = graph.units(table).collect();
        if node.entry.grain == Grain::Line && !node.is_small() {
            // The units are sorted by line, because the points of a sweep share the reading of a line.
            units.sort_by_key(|u| (u.line, u.instance));
        }
        let (mut chunks, mut start, mut bytes) = (vec![], 0, 0);
        for (i, unit) in units.iter().enumerate() {
            let own = cut.bytes(*unit);
            let together = unit.line.is_some() && units[start].line == unit.line && i - start < POINTS_TOGETHER;
            if i > start && bytes + own > CHUNK_BYTES && !together {
                chunks.push(start..i);
                (start, bytes) = (i, 0);
            }
            bytes += own;
        }
        if start < units.len() {
            chunks.push(start..units.len());
        }
        TableLayout { units, chunks }
    }
}

/// Packs of the store that contain rows of a table exactly as needed.
pub struct PackCover {
    /// Packs, in the order of the rows.
    pub packs: Vec<HashKey>,
    /// Whether each unit is in one of the packs.
    pub covered: Vec<bool>,
}

/// Finds packs whose units are all needed, without duplicates. For each unit of `layout` that was computed or has
/// failed, `wanted` holds its pack entry; the field `rows` of the entry is ignored. With `strict`, a pack counts only
/// if it is a whole chunk.
pub fn cover(
    catalogue: &PackCatalogue,
    kind: HashKey,
    layout: &TableLayout,
    wanted: &[Option<PackedUnit>],
    strict: bool,
) -> PackCover {
    let at: HashMap<(HashKey, u64), usize> =
        wanted.iter().enumerate().filter_map(|(i, w)| w.as_ref().map(|w| ((w.key, w.passthrough_hash), i))).collect();
    // A single chunk is always one pack, so that the bytes of small tables do not depend on earlier runs.
    let strict = strict || layout.chunks.len() <= 1;
    let mut found: Vec<(bool, usize, usize, HashKey, Vec<usize>)> = vec![];
    for pack in catalogue.packs().filter(|p| p.kind == kind) {
        let places: Option<Vec<usize>> =
            pack.units.iter().map(|u| at.get(&(u.key, u.passthrough_hash)).copied()).collect();
        let Some(places) = places.filter(|p| !p.is_empty()) else { continue };
        let (first, last) = (places[0], places[places.len() - 1]);
        let chunk = layout.chunks.get(layout.chunks.partition_point(|c| c.end <= first));
        // Units without a pack entry are excluded from the chunk.
        let exact = chunk.is_some_and(|c| {
            c.contains(&last) && c.clone().filter(|i| wanted[*i].is_some()).eq(places.iter().copied())
        });
        if exact || !strict {
            found.push((!exact, usize::MAX - places.len(), first, pack.id, places));
        }
    }
    found.sort();
    let mut covered = vec![false; wanted.len()];
    let mut packs = vec![];
    for (_, _, first, id, places) in found {
        if places.iter().all(|i| !covered[*i]) {
            places.iter().for_each(|i| covered[*i] = true);
            packs.push((first, id));
        }
    }
    packs.sort();
    PackCover { packs: packs.into_iter().map(|(_, id)| id).collect(), covered }
}

/// Whether a table of `chunks` chunks has too many packs.
pub fn scattered(packs: usize, chunks: usize) -> bool {
    packs > 2 * chunks + 16
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use store::StorePack;

    fn packed(name: usize) -> PackedUnit {
        PackedUnit { key: HashKey::from_parts([name.to_string()]), passthrough_hash: name as u64, rows: 5 }
    }

    fn catalogue(packs: &[&[usize]]) -> PackCatalogue {
        let mut catalogue = PackCatalogue::default();
        for units in packs {
            let id = HashKey::from_parts(units.iter().map(usize::to_string));
            let units = units.iter().map(|u| packed(*u)).collect();
            catalogue.insert(StorePack { id, size: 1, modified_ns: 1, kind: HashKey::from_parts(["kind"]), units });
        }
        catalogue
    }

    /// Covers six units, in chunks of three, by these packs. Returns the first unit of each chosen pack, and the number
    /// of covered units.
    fn covered(packs: &[&[usize]], strict: bool) -> (Vec<usize>, usize) {
        let unit = |instance| PlanUnit { table: 0, instance, line: None };
        let layout = TableLayout { units: (0..6).map(unit).collect(), chunks: vec![0..3, 3..6] };
        let wanted: Vec<Option<PackedUnit>> = (0..6).map(|i| Some(packed(i))).collect();
        let catalogue = catalogue(packs);
        let found = cover(&catalogue, HashKey::from_parts(["kind"]), &layout, &wanted, strict);
        let first = |id: &HashKey| {
            let units = &catalogue.by_id(*id).unwrap().units;
            units.first().map_or(99, |u| u.passthrough_hash as usize)
        };
        (found.packs.iter().map(first).collect(), found.covered.iter().filter(|c| **c).count())
    }

    #[test]
    fn unit_cover_uses_only_fully_needed_packs_without_duplicate_units() {
        assert_eq!(covered(&[&[0, 1, 2], &[3, 4, 5]], true), (vec![0, 3], 6));
        // Packs that are whole chunks are chosen first; packs that overlap them are skipped.
        assert_eq!(covered(&[&[0, 1, 2, 3], &[0, 1, 2], &[3, 4], &[5]], false), (vec![0, 3, 5], 6));
        assert_eq!(covered(&[&[0, 1, 2], &[3, 4], &[5]], true), (vec![0], 3));
        // A pack with a unit that is no longer needed does not belong to this table.
        assert_eq!(covered(&[&[0, 1, 2], &[3, 4, 5, 7]], false), (vec![0], 3));
        assert_eq!(covered(&[], false), (vec![], 0));
        let other = catalogue(&[&[0, 1, 2]]);
        let layout = TableLayout { units: vec![], chunks: vec![] };
        assert!(cover(&other, HashKey::from_parts(["other"]), &layout, &[], false).packs.is_empty());
    }
}
