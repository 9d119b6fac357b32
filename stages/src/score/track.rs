//! Metrics of a track, of the INS alone and of the filter's opinion of itself.

use arrow_array::Array;
use numerics::regression::statistics::{self, Figure};
use schemas::{Fault, metric::Shown};

use crate::navigate::Update;

use super::{line::Line, metric::metric, source::Source};

metric! {
    /// distance root mean square: the root of the mean squared horizontal error of the track, about the truth
    DRMS = "drms", unit "m", pool Rms, better Lower,
    shown Shown::column(100, 150).rank(10).heat_map(), needs [Track, Position];
    |line| line.track_error().map(|e| statistics::drms(&e.north_m, &e.east_m))
}

metric! {
    /// root mean square error north
    RMS_NORTH = "rms_north", unit "m", pool Rms, better Lower, needs [Track, Position];
    |line| line.track_error().map(|e| statistics::rms(&e.north_m))
}

metric! {
    /// root mean square error east
    RMS_EAST = "rms_east", unit "m", pool Rms, better Lower, needs [Track, Position];
    |line| line.track_error().map(|e| statistics::rms(&e.east_m))
}

metric! {
    /// drms of the INS alone: what the filter must be better than
    INS_DRMS = "ins_drms", unit "m", pool Rms, better Neither,
    shown Shown::column(90, 140), needs [Position, Ins];
    |line| {
        let e = line.offsets(line.named(Source::Ins, "ins_lat")?, line.named(Source::Ins, "ins_lon")?)?;
        Ok(statistics::drms(&e.north_m, &e.east_m))
    }
}

metric! {
    /// mean normalised estimation error squared e'P^-1e of the horizontal position; 2 for a consistent filter, more for
    /// one that trusts itself too much, less for one that is too cautious
    NEES = "nees", unit "1", pool Mean, better Near(2.0),
    shown Shown::column(110, 110), needs [Track, Position];
    |line| {
        let (e, of_track) = (line.track_error()?, |name| line.named(Source::Track, name));
        let (sd_n, sd_e, cov_ne) = (of_track("sd_n")?, of_track("sd_e")?, of_track("cov_ne")?);
        Ok(statistics::mean(&statistics::position_nees(&e.north_m, &e.east_m, sd_n, sd_e, cov_ne)))
    }
}

metric! {
    /// mean normalised innovation squared; 1 for a consistent filter, more for one that trusts itself too much, less for
    /// one that is too cautious
    NIS = "nis", unit "1", pool Mean, better Near(1.0),
    shown Shown::column(120, 120).rank(70), needs [Track];
    |line| Ok(statistics::mean(line.named(Source::Track, "nis")?))
}

metric! {
    /// measurements that the filter used
    SAMPLES_USED = "samples_used", unit "1", pool Sum, better Neither, needs [Track];
    |line| count(line, Update::Used)
}

metric! {
    /// samples without a measurement
    SAMPLES_MISSING = "samples_missing", unit "1", pool Sum, better Neither, needs [Track];
    |line| count(line, Update::Missing)
}

metric! {
    /// samples off the map or in an unknown cell
    SAMPLES_OFF_MAP = "samples_off_map", unit "1", pool Sum, better Neither, needs [Track];
    |line| count(line, Update::OffMap)
}

metric! {
    /// measurements that the innovation gate left out
    SAMPLES_GATED = "samples_gated", unit "1", pool Sum, better Neither, needs [Track];
    |line| count(line, Update::Gated)
}

/// The number of samples whose `update` is this one.
fn count(line: &Line, update: Update) -> Result<Figure, Fault> {
    let updates = line.updates()?;
    let n = updates.iter().filter(|word| *word == Some(update.word())).count();
    Ok(Figure { value: n as f64, n: updates.len() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::score::testing::{Columns, FLOWN, seconds, track, value};

    /// Flown along the equator, the INS half as far away as the track: 0.001 deg north and 0.002 deg east.
    fn tables() -> [Columns; 2] {
        let truth = vec![
            (FLOWN[0], seconds(10, |_| 0.0)),
            (FLOWN[1], seconds(10, |t| 0.001 * t)),
            ("ins_lat", seconds(10, |_| 0.0005)),
            ("ins_lon", seconds(10, |t| 0.001 * t + 0.001)),
        ];
        [truth, track(seconds(10, |_| 0.001), seconds(10, |t| 0.001 * t + 0.002))]
    }

    #[test]
    fn law_a_constant_offset_is_its_own_drms() {
        let tables = tables();
        let [north, east, both, ins] = [RMS_NORTH, RMS_EAST, DRMS, INS_DRMS].map(|m| value(&m, &tables));
        // On the equator of WGS 84 a degree is 110.574 km north and 111.320 km east.
        assert!((north.value - 110.574).abs() < 0.001 && (east.value - 222.639).abs() < 0.001, "{north:?} {east:?}");
        assert!((both.value - north.value.hypot(east.value)).abs() < 1e-9 && both.n == 10);
        assert!((ins.value - both.value / 2.0).abs() < 1e-3, "{ins:?}");
    }

    #[test]
    fn law_an_error_of_one_sigma_in_each_direction_is_a_nees_of_two() {
        let mut tables = tables();
        let (north, east) = (value(&RMS_NORTH, &tables).value, value(&RMS_EAST, &tables).value);
        for (name, column) in &mut tables[1] {
            match *name {
                "sd_n" => column.fill(north),
                "sd_e" => column.fill(east),
                _ => {}
            }
        }
        assert!((value(&NEES, &tables).value - 2.0).abs() < 1e-9);
        assert_eq!(value(&NIS, &tables), Figure { value: 0.5, n: 10 });
    }

    #[test]
    fn law_every_sample_has_one_fate() {
        let counted = [SAMPLES_USED, SAMPLES_MISSING, SAMPLES_OFF_MAP, SAMPLES_GATED].map(|m| value(&m, &tables()));
        assert_eq!(counted.map(|f| f.value), [3.0, 3.0, 2.0, 2.0]);
        assert!(counted.iter().all(|f| f.n == 10));
    }
}
