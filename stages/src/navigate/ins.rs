//! INS of a line. Missing columns are derived.

use std::borrow::Cow;

use arrow_array::RecordBatch;
use numerics::navigation::{
    InsErrorModel,
    ins_error::{StartFix, correction_along},
    ins_series::InsSeries,
    strapdown,
};
use schemas::Fault;

use super::{ATTITUDE, FORCE, POSITION, VELOCITY};
use crate::columns::{data, floats};

type InsColumnTriple<'a> = [Cow<'a, [f64]>; 3];

/// Columns of an INS.
#[derive(Clone)]
pub(super) struct InsColumns<'a> {
    tt_s: &'a [f64],
    position: InsColumnTriple<'a>,
    velocity: InsColumnTriple<'a>,
    force: InsColumnTriple<'a>,
    attitude: InsColumnTriple<'a>,
}

fn three<'a>(batch: &'a RecordBatch, names: [&str; 3]) -> Result<[&'a [f64]; 3], Fault> {
    Ok([floats(batch, names[0])?, floats(batch, names[1])?, floats(batch, names[2])?])
}

impl<'a> InsColumns<'a> {
    /// Borrows the columns of the batch and derives the missing ones.
    pub(super) fn from_batch(batch: &'a RecordBatch) -> Result<Self, Fault> {
        let tt_s = floats(batch, "tt")?;
        let position @ [lat_deg, lon_deg, alt_m] = three(batch, POSITION)?;
        let read = |names: [&str; 3]| -> Result<Option<InsColumnTriple<'a>>, Fault> {
            let there = batch.column_by_name(names[0]).is_some();
            there.then(|| Ok(three(batch, names)?.map(Cow::Borrowed))).transpose()
        };
        let derived = |columns: [Vec<f64>; 3]| columns.map(Cow::Owned);
        let velocity = match read(VELOCITY)? {
            Some(velocity) => velocity,
            None => derived(strapdown::velocity_ned_mps(tt_s, lat_deg, lon_deg, alt_m).map_err(data)?),
        };
        let [vn_mps, ve_mps, vd_mps] = velocity.each_ref().map(|c| &**c);
        let force = match read(FORCE)? {
            Some(force) => force,
            None => {
                let velocity = [vn_mps, ve_mps, vd_mps];
                derived(strapdown::specific_force_ned_mps2(tt_s, [lat_deg, alt_m], velocity).map_err(data)?)
            }
        };
        let attitude = match read(ATTITUDE)? {
            Some(attitude) => attitude,
            None => derived(strapdown::level_attitude_deg(vn_mps, ve_mps).map_err(data)?),
        };
        Ok(Self { tt_s, position: position.map(Cow::Borrowed), velocity, force, attitude })
    }

    /// Corrects the INS by a position and velocity fix at a row near the start of the line.
    pub(super) fn corrected(self, fix: &StartFix, row: usize) -> Self {
        let series = self.series();
        let rest = series.from(row);
        let first = fix.error(&rest);
        let corrections = correction_along(&InsErrorModel::default(), &series, row, first);
        let mut corrections = corrections.into_iter();
        let mut add = |to: &Cow<[f64]>| -> Cow<'a, [f64]> {
            let by = corrections.next().unwrap_or_default();
            Cow::Owned(to.iter().zip(by).map(|(value, by)| value + by).collect())
        };
        let position = self.position.each_ref().map(&mut add);
        let velocity = self.velocity.each_ref().map(&mut add);
        Self { position, velocity, ..self }
    }

    /// Columns as input of a filter.
    pub(super) fn series(&self) -> InsSeries<'_> {
        let ([lat, lon, alt], [vn, ve, vd]) =
            (self.position.each_ref().map(|c| &**c), self.velocity.each_ref().map(|c| &**c));
        let ([force_n, force_e, force_d], [roll, pitch, yaw]) =
            (self.force.each_ref().map(|c| &**c), self.attitude.each_ref().map(|c| &**c));
        InsSeries::from_columns([self.tt_s, lat, lon, alt, vn, ve, vd, force_n, force_e, force_d, roll, pitch, yaw])
    }

    /// Heights above the ellipsoid, in metres.
    pub(super) fn alt_m(&self) -> &[f64] {
        &self.position[2]
    }

    /// Mean distance from one sample to the next, in metres.
    pub(super) fn step_m(&self) -> f64 {
        let [vn_mps, ve_mps, _] = &self.velocity;
        let speed_mps = vn_mps.iter().zip(ve_mps.iter()).map(|(n, e)| n.hypot(*e)).sum::<f64>() / vn_mps.len() as f64;
        let duration_s = self.tt_s.last().zip(self.tt_s.first()).map_or(0.0, |(last, first)| last - first);
        (speed_mps * duration_s / (self.tt_s.len() as f64 - 1.0)).max(0.1)
    }
}

/// Whether two batches have the same INS: the same columns, bit by bit.
pub(super) fn same(a: &RecordBatch, b: &RecordBatch) -> bool {
    let names = ["tt"].into_iter().chain(POSITION).chain(VELOCITY).chain(FORCE).chain(ATTITUDE);
    names.into_iter().all(|name| match (a.column_by_name(name), b.column_by_name(name)) {
        (Some(one), Some(other)) if std::sync::Arc::ptr_eq(one, other) => true,
        (Some(_), Some(_)) => match (floats(a, name), floats(b, name)) {
            (Ok(one), Ok(other)) => {
                std::ptr::eq(one, other)
                    || one.len() == other.len() && one.iter().zip(other).all(|(a, b)| a.to_bits() == b.to_bits())
            }
            _ => false,
        },
        (one, other) => one.is_none() && other.is_none(),
    })
}
