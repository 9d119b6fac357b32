//! The variation of the earth's field with time.

use datasets::formats::read_iaga2002;
use numerics::signal::spectrum::{SpectralTaper, welch};

use super::super::variation::{PulsationWaves, QuietDay, ring_current};
use super::*;
use crate::random::RandomStream;

#[test]
fn law_the_quiet_day_is_large_by_day_and_small_at_night() {
    let quiet = QuietDay::new(40.0);
    let at = |hour: f64, lat: f64| quiet.at(3600.0 * hour, lat, 0.0);
    let sizes: Vec<f64> = (0..240).map(|k| at(0.1 * f64::from(k), 35.0).norm()).collect();
    let most = sizes.iter().copied().fold(0.0, f64::max);
    assert!((most - 40.0).abs() < 0.05, "{most}");
    assert!(at(0.0, 35.0).norm() < 1e-12 && (20..24).chain(0..4).all(|h| at(f64::from(h), 35.0).norm() < 8.0));
    // Sq at observatories: in the northern hemisphere the field is eastward in the morning, westward in the afternoon
    // and upward at noon. In the southern hemisphere these signs are reversed. At noon the field is northward at the
    // equator and southward at 60 degrees.
    assert!(at(9.0, 40.0).y > 10.0 && at(15.0, 40.0).y < -10.0 && at(9.0, -40.0).y < -10.0);
    assert!(at(12.0, 40.0).z < -5.0 && at(12.0, -40.0).z > 5.0);
    assert!(at(12.0, 0.0).x > 20.0 && at(12.0, 60.0).x < -5.0);
    // Local time: noon at 90 east is 6 h UTC.
    assert!((quiet.at(3600.0 * 6.0, 20.0, 90.0) - at(12.0, 20.0)).norm() < 1e-9);
}

#[test]
fn law_the_quiet_day_has_no_curl_over_the_ground() {
    let quiet = QuietDay::new(40.0);
    let (lat, h) = (33.0_f64, 1e-3_f64);
    for hour in [6.0, 9.5, 13.0] {
        let at = |lat: f64, lon: f64| quiet.at(3600.0 * hour, lat, lon);
        // The value of midnight is subtracted. The subtracted value is northward only and independent of longitude, so
        // it does not affect the curl.
        let d_east = (at(lat + h, 10.0).y * (lat + h).to_radians().cos()
            - at(lat - h, 10.0).y * (lat - h).to_radians().cos())
            / (2.0 * h);
        let d_north = (at(lat, 10.0 + h).x - at(lat, 10.0 - h).x) / (2.0 * h);
        assert!((d_east - d_north).abs() < 1e-5, "{hour}: {d_east} {d_north}");
    }
}

#[test]
fn law_pulsations_have_the_declared_band_and_amplitude() {
    for (period_s, width) in [(20.0, 0.1), (100.0, 0.05)] {
        let pulsations = Pulsations { sigma_nt: 2.0, period_s, width };
        let waves = PulsationWaves::draw(&pulsations, &mut RandomStream::new(4, &["test"]));
        let x: Vec<Vector3<f64>> = (0..60_000).map(|k| waves.at(f64::from(k))).collect();
        let north: Vec<f64> = x.iter().map(|v| v.x).collect();
        let spectrum = welch(&north, 1.0, 4096, SpectralTaper::Hann).unwrap();
        let peak = spectrum.density.iter().zip(&spectrum.frequency_hz).max_by(|a, b| a.0.total_cmp(b.0)).unwrap();
        // The largest of 32 waves with frequencies drawn about the centre.
        assert!((peak.1 * period_s - 1.0).abs() < 3.0 * width, "{peak:?}");
        let within = |f: f64| (f * period_s - 1.0).abs() < 4.0 * width + 0.02;
        let (band, all) = spectrum
            .density
            .iter()
            .zip(&spectrum.frequency_hz)
            .fold((0.0, 0.0), |(band, all), (d, f)| (if within(*f) { band + d } else { band }, all + d));
        assert!(band / all > 0.99, "{}", band / all);
        let std = rms(x.iter().map(|v| Vector3::new(v.x, 0.0, 0.0)).collect::<Vec<_>>().iter());
        // Waves of equal amplitude have an exact mean square, except for beats that 60,000 s do not average: a few
        // percent.
        assert!((std / 2.0 - 1.0).abs() < 0.1, "{std}");
        let envelope: Vec<f64> = x.iter().map(|v| v.x.hypot(v.y / 0.4)).collect();
        let (least, most) = envelope.iter().fold((f64::MAX, 0.0_f64), |(a, b), e| (a.min(*e), b.max(*e)));
        assert!(least < 0.5 && most > 5.0, "packets come and go: {least} to {most}");
    }
}

#[test]
fn law_a_storm_begins_suddenly_and_recovers_slowly() {
    let storm = Storm { depth_nt: 200.0, start_tt_s: 1000.0, main_s: 20_000.0, recovery_s: 50_000.0 };
    assert_eq!((storm.at(0.0), storm.at(1000.0)), (0.0, 0.0));
    assert!(storm.at(1300.0) > 0.2 * 200.0, "the commencement: {}", storm.at(1300.0));
    let samples: Vec<f64> = (0..2000).map(|k| storm.at(100.0 * f64::from(k))).collect();
    let deepest = (0..2000).min_by(|a, b| samples[*a].total_cmp(&samples[*b])).unwrap();
    assert!((f64::from(deepest as u32) * 100.0 - 21_000.0).abs() < 500.0);
    // The unfinished part of the commencement is 0.25 e^-6 of the depth.
    assert!((samples[deepest] + 200.0).abs() < 0.3, "{}", samples[deepest]);
    assert!((storm.at(71_000.0) + 200.0 / 1f64.exp()).abs() < 1e-4);
    assert!(samples.windows(2).skip(30).all(|w| (w[1] - w[0]).abs() < 3.0), "smooth but for the commencement");
    // Southward at mid latitudes, and down in the north.
    let b = ring_current(45.0, 10.0) * -100.0;
    assert!(b.x < -60.0 && b.z > 15.0 && b.y.abs() < 20.0, "{b}");
    assert!((ring_current(80.65, -72.68) - Vector3::new(0.0, 0.0, -0.46 / 1.27)).norm() < 1e-12);
}

#[test]
fn unit_the_variation_equals_the_record_at_its_samples() {
    let path = samples::path("boulder/bou20141104vmin.min");
    let record = read_iaga2002(&path).unwrap();
    let seen = ObservatoryVariation::read(&path, false).unwrap();
    let minutes: Vec<Vector3<f64>> = (0..1440).map(|k| seen.at(60.0 * f64::from(k)).unwrap()).collect();
    let mean: Vector3<f64> = minutes.iter().sum::<Vector3<f64>>() / 1440.0;
    assert!(mean.norm() < 1e-8, "counted from the mean: {mean}");
    for k in 0..1440 {
        let change = Vector3::from(record.ned_nt[k]) - Vector3::from(record.ned_nt[0]);
        // Rounding of 5e4 nT, through a spline.
        assert!((minutes[k] - minutes[0] - change).norm() < 1e-9, "{k}");
    }
    let between = seen.at(60.0 * 700.0 + 30.0).unwrap();
    let middle = 0.5 * (minutes[700] + minutes[701]);
    assert!((between - middle).norm() < 0.5 && between != middle, "{between} {middle}");
    // From 0 to 3 in the morning at Boulder is 7 to 10 UTC.
    let quiet = ObservatoryVariation::read(&path, true).unwrap();
    let night: Vector3<f64> = (421..=600).map(|k| quiet.at(60.0 * f64::from(k)).unwrap()).sum::<Vector3<f64>>() / 180.0;
    assert!(night.norm() < 0.1, "{night}");
    let late = seen.at(86_400.0).unwrap_err();
    assert_eq!(late, "the record of the observatory BOU has no value at 24:00:00.0 (86400.0 s past midnight UTC)");
    // A gap: 99999 at 10:05.
    let text = fs::read_to_string(&path).unwrap();
    let row = text.lines().find(|l| l.contains("10:05:00")).unwrap();
    let folder = TempDir::new().unwrap();
    let holed = folder.path().join("h.min");
    fs::write(&holed, text.replace(row, &format!("{} 99999.00 99999.00 99999.00 99999.00", &row[..27]))).unwrap();
    let holed = ObservatoryVariation::read(&holed, false).unwrap();
    assert!(holed.at(36_240.0).is_ok() && holed.at(36_360.0).is_ok());
    for tt in [36_241.0, 36_300.0, 36_359.0] {
        assert!(holed.at(tt).is_err(), "{tt}");
    }
}

#[test]
fn law_a_flight_has_the_record_along_the_core_field() {
    let path = samples::path("boulder/bou20141104vmin.min");
    let text = format!(
        "year = 2014\ndoy = 308\n[components]\nanomaly = false\n[diurnal]\nobservatory = '{}'\n{BARE}{LINE}",
        path.display()
    );
    let line = &simulate(&text)[0];
    let seen = ObservatoryVariation::read(&path, false).unwrap();
    for i in [0, 300, 600] {
        let (tt, lat, lon) = (column(line, "tt")[i], column(line, "lat")[i], column(line, "lon")[i]);
        let core = field_at(CoreFieldModel::Igrf14, decimal_year(2014, 308, tt).unwrap(), lat, lon, 500.0);
        let variation = seen.at(tt).unwrap();
        assert!((column(line, "diurnal")[i] - variation.dot(&core.normalize())).abs() < 1e-6);
        assert!((column(line, "mag_1_c")[i] - (core + variation).norm()).abs() < 1e-6);
    }
    let night = try_simulate(&text.replace("start_tt_s = 36000.0", "start_tt_s = 86390.0")).unwrap_err();
    assert!(
        night.contains("flight A, line A.1: the record of the observatory BOU has no value at 23:59:50"),
        "{night}"
    );
    assert!(night.contains("move the flight to a time that the record covers"), "{night}");
}
