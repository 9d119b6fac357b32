//! The times and positions at which the field is computed along a line.

use numerics::earth::geodesy::EarthModel;

use crate::trajectory::TrueTrajectory;

/// Times and positions, one per sample, which are offset from a true trajectory.
pub(super) struct OffsetTrack<'a> {
    /// The positions of the samples.
    pub(super) own: &'a TrueTrajectory,
    /// Offsets of latitude and longitude (deg) and height (m) from these positions.
    pub(super) moved: Vec<[f64; 3]>,
    pub(super) tt_s: Vec<f64>,
    pub(super) lat_deg: Vec<f64>,
    pub(super) lon_deg: Vec<f64>,
    pub(super) alt_m: Vec<f64>,
}

impl OffsetTrack<'_> {
    /// For each sample of a track: the position on the tangent at the sample, `by_s` seconds ahead.
    pub(super) fn from_truth(truth: &TrueTrajectory, by_s: f64) -> OffsetTrack<'_> {
        let earth = EarthModel::Wgs84;
        let step = |i: usize| {
            let (lat_rad, alt_m) = (truth.lat_deg[i].to_radians(), truth.alt_m[i]);
            let [north_mps, east_mps, down_mps] = truth.velocity_mps.each_ref().map(|v| v[i]);
            [
                by_s * (north_mps / earth.north_m_per_rad(lat_rad, alt_m)).to_degrees(),
                by_s * (east_mps / earth.east_m_per_rad(lat_rad, alt_m)).to_degrees(),
                -by_s * down_mps,
            ]
        };
        let still = by_s == 0.0;
        let moved: Vec<_> = (0..truth.tt_s.len()).map(|i| if still { [0.0; 3] } else { step(i) }).collect();
        let on = |from: &[f64], k: usize| from.iter().zip(&moved).map(|(x, by)| x + by[k]).collect();
        OffsetTrack {
            own: truth,
            tt_s: truth.tt_s.iter().map(|tt| tt + by_s).collect(),
            lat_deg: on(&truth.lat_deg, 0),
            lon_deg: on(&truth.lon_deg, 1),
            alt_m: on(&truth.alt_m, 2),
            moved,
        }
    }
}
