//! Predictions of a measurement: the value at the position of each particle, and the common row of H.

use nalgebra::{Matrix3, Vector3};

use crate::earth::attitude::skew;
use crate::maps::map_stack::FieldMap;
use crate::maps::map_surface::FieldColumns;
use crate::navigation::aids::{Aid, AidStates, Aids, rotation};
use crate::navigation::line::NavigationLine;
use crate::navigation::pinson::{ALT, LAT, LON, S, TILT_N};

use super::cloud::{BLOCK, NO_SUMS, ParticleCloud, accumulate, total};
use super::core_expansion::CoreExpansion;
use super::filter::CorrectionSource;
use super::measurement::CloudPrediction;

/// Map and core field at the positions of the particles.
#[derive(Clone, Debug)]
pub(super) struct ParticleFields<'a> {
    line: &'a NavigationLine<'a>,
    map: &'a FieldMap,
    aids: &'a Aids<'a>,
    states: AidStates,
    offset_nt: f64,
    core: Option<CoreExpansion>,
    places: [Vec<f64>; 3],
    /// Fields at the positions of the particles, and at the other end of a baseline.
    fields: [FieldColumns; 2],
}

/// Entries of a row of H that are common to all particles.
type CommonEntries = Vec<(usize, f64)>;

impl<'a> ParticleFields<'a> {
    pub(super) fn new(
        line: &'a NavigationLine<'a>,
        aids: &'a Aids<'a>,
        states: AidStates,
        offset_nt: f64,
        blocks: usize,
    ) -> Self {
        let column = || vec![0.0; blocks * BLOCK];
        Self {
            line,
            map: line.map,
            aids,
            states,
            offset_nt,
            core: line.core.map(|core| CoreExpansion::new(core.clone())),
            places: [column(), column(), column()],
            fields: [FieldColumns::default(), FieldColumns::default()],
        }
    }

    /// Changes the number of blocks of particles.
    pub(super) fn resize(&mut self, blocks: usize) {
        self.places.iter_mut().for_each(|column| column.resize(blocks * BLOCK, 0.0));
    }

    /// Measurement and its variance, if the measurement exists.
    pub(super) fn measured(&self, turn: CorrectionSource, row: usize) -> Option<(f64, f64)> {
        let CorrectionSource::Further(aid) = turn else {
            return self.line.measured(row, self.offset_nt).filter(|_| self.line.sigma_nt[row] > 0.0);
        };
        let (value, sigma) = match aid {
            Aid::Difference => self.aids.difference.map(|of| (of.difference_nt[row], of.sigma_nt))?,
            Aid::Vector(axis) => {
                let of = self.aids.vector?;
                let all = of.field_nt.iter().all(|column| column[row].is_finite());
                (of.field_nt[axis][row], if all { of.sigma_nt } else { f64::NAN })
            }
            Aid::Height => self.aids.height.map(|of| (of.alt_m[row] - self.line.ins.alt_m[row], of.sigma_m))?,
        };
        (value.is_finite() && sigma.is_finite()).then_some((value, sigma * sigma))
    }

    /// Computes the prediction of a measurement for each particle; `middle` is the mean state.
    pub(super) fn at<const N: usize>(
        &mut self,
        turn: CorrectionSource,
        row: usize,
        cloud: &ParticleCloud<N>,
        middle: &[f64; N],
        out: &mut CloudPrediction,
    ) -> Option<CommonEntries> {
        if let Some(core) = &mut self.core {
            let [lat, lon, alt] = origin(self.line, row);
            core.follow(lat + middle[LAT].to_degrees(), lon + middle[LON].to_degrees(), alt + middle[ALT]);
        }
        match turn {
            CorrectionSource::Fixes => None,
            CorrectionSource::Scalar => self.scalar(row, cloud, out),
            CorrectionSource::Further(Aid::Difference) => self.difference(row, cloud, out),
            CorrectionSource::Further(Aid::Vector(axis)) => self.vector(axis, row, cloud, middle, out),
            CorrectionSource::Further(Aid::Height) => {
                out.values.iter_mut().chain(&mut out.d_alt).for_each(|lanes| lanes.fill(0.0));
                self.states.height.map(|bias| vec![(ALT, 1.0), (bias, 1.0)])
            }
        }
    }

    fn scalar<const N: usize>(
        &mut self,
        row: usize,
        cloud: &ParticleCloud<N>,
        out: &mut CloudPrediction,
    ) -> Option<CommonEntries> {
        self.look_up(0, row, cloud, [0.0; 3])?;
        let [lat_deg, lon_deg, alt_m] = &self.places;
        for (number, (values, d_alt)) in out.values.iter_mut().zip(&mut out.d_alt).enumerate() {
            for lane in 0..BLOCK {
                let index = number * BLOCK + lane;
                let (core_nt, core_slope) =
                    self.core.as_ref().map_or((0.0, 0.0), |core| core.at(lat_deg[index], lon_deg[index], alt_m[index]));
                values[lane] = self.fields[0].value_nt[index] + core_nt;
                d_alt[lane] = self.fields[0].d_alt_nt_per_m[index] + core_slope;
            }
        }
        Some([(S, 1.0)].into_iter().chain(self.states.map_error.map(|state| (state, 1.0))).collect())
    }

    /// Difference of the fields at both ends of the baseline. The effect of the tilt on the baseline is computed with
    /// the mean slope of all particles. The error of using the mean slope is 0.001 nT.
    fn difference<const N: usize>(
        &mut self,
        row: usize,
        cloud: &ParticleCloud<N>,
        out: &mut CloudPrediction,
    ) -> Option<CommonEntries> {
        let (of, bias) = self.aids.difference.zip(self.states.difference)?;
        let arm = of.arm(self.line, row);
        let mut core = vec![];
        for (end, sign) in [1.0, -1.0].into_iter().enumerate() {
            self.look_up(end, row, cloud, arm.offset.map(|part| sign * part))?;
            let [lats, lons, alts] = &self.places;
            let places = lats.iter().zip(lons).zip(alts);
            let at = |((lat, lon), alt): ((&f64, &f64), &f64)| {
                self.core.as_ref().map_or((0.0, 0.0), |core| core.at(*lat, *lon, *alt))
            };
            core.push(places.map(at).collect::<Vec<(f64, f64)>>());
        }
        let [first, second] = &self.fields;
        let (mut known, mut slopes) = (NO_SUMS, [NO_SUMS; 3]);
        for (number, weights) in cloud.weights.iter().enumerate() {
            let (values, d_alt) = (&mut out.values[number], &mut out.d_alt[number]);
            let mut sums = [[0.0; BLOCK]; 3];
            let mut of_known = [0.0; BLOCK];
            for lane in 0..BLOCK {
                let index = number * BLOCK + lane;
                let [(core_1, slope_1), (core_2, slope_2)] = [core[0][index], core[1][index]];
                values[lane] = (first.value_nt[index] + core_1) - (second.value_nt[index] + core_2);
                let up = [first.d_alt_nt_per_m[index] + slope_1, second.d_alt_nt_per_m[index] + slope_2];
                d_alt[lane] = up[0] - up[1];
                let lat = 0.5 * (first.d_lat_nt_per_rad[index] + second.d_lat_nt_per_rad[index]);
                let lon = 0.5 * (first.d_lon_nt_per_rad[index] + second.d_lon_nt_per_rad[index]);
                if values[lane].is_finite() {
                    of_known[lane] = weights[lane];
                    (sums[0][lane], sums[1][lane], sums[2][lane]) = (lat, lon, 0.5 * (up[0] + up[1]));
                }
            }
            accumulate(&mut known, |lane| of_known[lane]);
            for (slopes, own) in slopes.iter_mut().zip(&sums) {
                accumulate(slopes, |lane| of_known[lane] * own[lane]);
            }
        }
        let share = total(&known);
        let [d_lat, d_lon, d_alt] = slopes.each_ref().map(|sums| if share > 0.0 { total(sums) / share } else { 0.0 });
        let [core_lat, core_lon] = self.core.as_ref().map_or([0.0; 2], CoreExpansion::gradient);
        let tilt = arm.by_tilt(d_lat + core_lat, d_lon + core_lon, d_alt);
        let slope = of.slope_block(&self.states, self.line, row);
        Some((TILT_N..).zip(tilt).chain([(bias, 1.0)]).chain(slope.iter()).collect())
    }

    /// Component of the field vector. The core field is linear over the cloud, and the effect of the tilt is linearised
    /// at its mean.
    fn vector<const N: usize>(
        &mut self,
        axis: usize,
        row: usize,
        cloud: &ParticleCloud<N>,
        middle: &[f64; N],
        out: &mut CloudPrediction,
    ) -> Option<CommonEntries> {
        let (of, (bias, crustal)) = self.aids.vector.zip(self.states.vector)?;
        self.look_up(0, row, cloud, [0.0; 3])?;
        let [lat_deg, lon_deg, alt_m] = origin(self.line, row);
        let place = [lat_deg + middle[LAT].to_degrees(), lon_deg + middle[LON].to_degrees(), alt_m + middle[ALT]];
        let (here, slopes) = of.core_about(self.line.errors.earth, place);
        let direction = here / here.norm();
        let tilt = Vector3::new(middle[TILT_N], middle[TILT_N + 1], middle[TILT_N + 2]);
        let to_body = rotation(self.line.ins, row).transpose();
        let turn = to_body * (Matrix3::identity() + skew(&tilt));
        let along = (turn * direction)[axis];
        let by_place = slopes.map(|slope| (turn * slope)[axis]);
        let anomaly = &self.fields[0];
        let (mut known, mut sum) = (NO_SUMS, NO_SUMS);
        for (number, (block, weights)) in cloud.blocks.iter().zip(&cloud.weights).enumerate() {
            let of = |lane: usize| anomaly.value_nt[number * BLOCK + lane];
            let weight = |lane: usize| if of(lane).is_finite() { weights[lane] } else { 0.0 };
            accumulate(&mut known, weight);
            accumulate(
                &mut sum,
                |lane| if weight(lane) > 0.0 { weight(lane) * (of(lane) + block[S][lane]) } else { 0.0 },
            );
        }
        let mean_nt = if total(&known) > 0.0 { total(&sum) / total(&known) } else { 0.0 };
        let by_tilt = -to_body * skew(&(here + direction * mean_nt));
        let by_tilt = [0, 1, 2].map(|part| by_tilt[(axis, part)]);
        let fixed = (turn * here)[axis] - by_tilt.iter().zip(&tilt).map(|(h, tilt)| h * tilt).sum::<f64>();
        for (number, block) in cloud.blocks.iter().enumerate() {
            for (lane, index) in (number * BLOCK..(number + 1) * BLOCK).enumerate() {
                let moved: f64 =
                    [LAT, LON, ALT].iter().zip(by_place).map(|(k, slope)| slope * (block[*k][lane] - middle[*k])).sum();
                out.values[number][lane] = fixed + moved + along * anomaly.value_nt[index];
                out.d_alt[number][lane] = by_place[2] + along * anomaly.d_alt_nt_per_m[index];
            }
        }
        let own = [(S, along), (bias + axis, 1.0)];
        let crustal = (0..3).map(|part| (crustal + part, turn[(axis, part)]));
        Some((TILT_N..).zip(by_tilt).chain(own).chain(crustal).collect())
    }

    /// Map at the particles' positions, shifted by an offset in latitude and longitude (rad) and height (m).
    fn look_up<const N: usize>(
        &mut self,
        into: usize,
        row: usize,
        cloud: &ParticleCloud<N>,
        offset: [f64; 3],
    ) -> Option<()> {
        let origin = origin(self.line, row);
        let [lats, lons, alts] = &mut self.places;
        let columns = lats.chunks_exact_mut(BLOCK).zip(lons.chunks_exact_mut(BLOCK)).zip(alts.chunks_exact_mut(BLOCK));
        for (block, ((lat, lon), alt)) in cloud.blocks.iter().zip(columns) {
            for lane in 0..BLOCK {
                lat[lane] = origin[0] + (block[LAT][lane] + offset[0]).to_degrees();
                lon[lane] = origin[1] + (block[LON][lane] + offset[1]).to_degrees();
                alt[lane] = origin[2] + (block[ALT][lane] + offset[2]);
            }
        }
        let [lat_deg, lon_deg, alt_m] = &self.places;
        // Three columns of equal length are always accepted.
        self.map.at_many(lat_deg, lon_deg, alt_m, &mut self.fields[into]).ok()
    }
}

/// Position of the INS.
fn origin(line: &NavigationLine<'_>, row: usize) -> [f64; 3] {
    [line.ins.lat_deg[row], line.ins.lon_deg[row], line.ins.alt_m[row]]
}
