//! Currents, the wires they flow in, and servos.

use super::{
    super::{super::random::RandomStream, currents::switched},
    *,
};

#[test]
fn law_wires_and_flex_have_the_declared_fields() {
    let sensors = "[[currents]]\nname = 'cur_x'\nkind = 'steady'\non_a = 3.0\n[[wires]]\ncurrent = 'cur_x'\n\
                   path = [[-2000.0, 0.0, 0.0], [2000.0, 0.0, 0.0]]\n[[vector_magnetometers]]\nname = 'flux_a'\n\
                   position_m = [0.0, 4.0, 0.0]\n[[vector_magnetometers]]\nname = 'flux_b'\nflex = [0.0, 2.0, 0.0]\n\
                   flex_limit_mps2 = 0.05\n";
    let line = &lines_of("component_columns = true", sensors, SURVEY)[0];
    // 3 A at 4 m: 200 nT m/A / 4 m × 3 A, downwards on the right of a forward current.
    assert!(column(line, "part_currents_flux_a_z").iter().all(|b| (b - 150.0).abs() < 1e-3));
    assert!(
        column(line, "part_currents_flux_b_z").iter().all(|b| *b == 0.0),
        "without a position, wires have no effect"
    );
    let flex = column(line, "part_flex_flux_b_y");
    assert!(flex.iter().all(|b| b.abs() <= 0.1 + 1e-12) && flex.contains(&0.1) && sd(flex) > 0.0);
}

#[test]
fn law_currents_switch_between_their_levels() {
    let intervals = switched((8.0, 4.0), 0.0, 2e4, &mut RandomStream::new(5, &["test"]));
    assert!(intervals.windows(2).all(|w| w[0][1] < w[1][0]));
    let on = intervals.iter().map(|[from, until]| until.min(2e4) - from.max(0.0)).sum::<f64>() / 2e4;
    // There are 1667 cycles. The tolerance of the share of 1/3 is four standard errors of 0.008.
    assert!((on - 1.0 / 3.0).abs() < 0.032, "{on}");
    let starts_on = |k: &usize| {
        let mut random = RandomStream::new(5, &["start", &k.to_string()]);
        switched((8.0, 4.0), 0.0, 0.0, &mut random).first().is_some_and(|[from, _]| *from < 0.0)
    };
    let first = (0..300).filter(starts_on).count() as f64 / 300.0;
    // The tolerance is four standard errors of 0.027.
    assert!((first - 1.0 / 3.0).abs() < 0.11, "{first}");
}

#[test]
fn law_currents_follow_their_schedules() {
    let currents = "[[currents]]\nname = 'cur_s'\nkind = 'schedule'\nschedule = [[10.0, 20.0], [50.0, 60.0]]\n\
                    ramp_s = 4.0\noff_a = 1.0\non_a = 5.0\n\
                    [[currents]]\nname = 'cur_p'\nkind = 'periodic'\nevery_s = 1.5\nfor_s = 0.3\non_a = 2.0\n\
                    scale = 1.1\n\
                    [[currents]]\nname = 'cur_h'\nkind = 'heater'\non_a = 7.0\nkeep_degc = 30.0\nwarm_tau_s = 40.0\n\
                    [[currents]]\nname = 'cur_e'\nkind = 'engine'\non_a = 100.0\ncruise = 0.4\nper_load = 0.0\n\
                    [[currents]]\nname = 'cur_n'\nkind = 'steady'\non_a = 1.0\nmeasured = false\n\
                    [[voltages]]\nname = 'vol_b'\nvolts = 24.0\nohm = { cur_e = 0.05, cur_n = 1.0 }\n\
                    discharge_v_per_h = 36.0\n[[inputs]]\nname = 'throttle'\nkind = 'current'\nof = 'cur_e'\n\
                    gain = 100.0\n";
    let line = &lines_of("", currents, SURVEY)[0];
    let c = |name: &str| column(line, name);
    for (t, a) in
        [(9.9, 1.0), (10.0, 1.0), (12.0, 3.0), (15.0, 5.0), (22.0, 3.0), (24.0, 1.0), (52.0, 3.0), (90.0, 1.0)]
    {
        assert!((c("cur_s")[(t * 10.0_f64).round() as usize] - a).abs() < 1e-9, "{t} s");
    }
    for (i, a) in c("cur_p").iter().enumerate() {
        assert_eq!(*a, if i % 15 < 3 { 2.2 } else { 0.0 }, "{i}");
    }
    let switches = c("cur_h").windows(2).filter(|w| w[0] != w[1]).count();
    assert!((3..60).contains(&switches), "the heater switches on and off: {switches}");
    // Level flight at the cruising speed; the earth's curvature and the weave change the load by 1e-6.
    assert!(c("cur_e").iter().all(|a| (a - 40.0).abs() < 2e-4) && (c("throttle")[7] - 40.0).abs() < 2e-4);
    // 40 A through 0.05 ohm, 1 A without a sensor through 1 ohm, and a discharge of 0.01 V/s.
    assert!((c("vol_b")[100] - (24.0 - 2.0 - 1.0 - 0.1)).abs() < 1e-4);
    assert!(line.column_by_name("cur_n").is_none());
}

#[test]
fn law_servos_follow_the_attitude() {
    let current = "[[currents]]\nname = 'cur_r'\nkind = 'servo'\naxes = [1.0, 0.0, 0.0]\nfull_dps = 30.0\non_a = 6.0\n\
                   signed = true\n";
    let line = &lines_of("", current, SURVEY)[0];
    let angle = |name: &str, i: usize| column(line, name)[i].to_radians();
    let roll = column(line, "roll");
    for i in 1..line.num_rows() - 1 {
        // The roll rate from the rates about the body's axes. [Titterton & Weston 2004, (3.44)]
        let across = column(line, "pitch_rate")[i] * angle("roll", i).sin();
        let down = column(line, "yaw_rate")[i] * angle("roll", i).cos();
        let rate = column(line, "roll_rate")[i] + (across + down) * angle("pitch", i).tan();
        assert!((column(line, "cur_r")[i] - 6.0 * rate / 30.0).abs() < 1e-9, "{i}");
        let difference = (roll[i + 1] - roll[i - 1]) / 0.2;
        // The error h²/6 times the third derivative of a sway of 1.5 degrees at up to 3 rad/s: 0.07 deg/s.
        assert!((rate - difference).abs() < 0.2, "{i}: {rate} {difference}");
    }
}

#[test]
fn ref_the_drones_currents_have_the_fields_of_its_ground_test() {
    let folder = TempDir::new().unwrap();
    let path = spec(&folder, "preset = 'drone'", "", SURVEY);
    let aircraft = Simulation::open(&path).unwrap().spec().aircraft.clone();
    // Van der Meer 2025, 3.2.3: the lights about 50 nT, steering around 10 nT, the engine around 5 nT.
    for (name, published_nt) in [("cur_led", 50.0), ("cur_srvo_a", 10.0), ("cur_batt", 5.0)] {
        let index = aircraft.currents.iter().position(|c| c.name == name).unwrap();
        let (off_a, on_a) = aircraft.currents[index].off_on_a;
        for sensor in &aircraft.scalars[1..] {
            let at_m = sensor.source.position_m.unwrap();
            let wires = aircraft.wires.iter().filter(|w| w.current == index);
            let field_nt = wires.map(|w| w.nt_per_a(&at_m)).sum::<Vector3<f64>>() * (on_a - off_a);
            assert!((0.7..1.4).contains(&(field_nt.norm() / published_nt)), "{name}: {} nT", field_nt.norm());
        }
    }
}
