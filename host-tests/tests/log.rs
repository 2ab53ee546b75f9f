//! Logs and configuration files: correct files are read, and the fault of a wrong file is reported in one line.

use host_tests::files::scheme_file::{read_scheme, scheme_named, write_scheme};
use host_tests::files::truth::Truth;
use host_tests::files::unit_file::{Noise, UnitConfig};
use host_tests::log::{COLUMNS, LogPlayer, LogReader, LogWriter};
use host_tests::virtual_unit::plant::Reading;
use host_tests::virtual_unit::presets::{errors_named, noise_named, real};
use rins_selfcal::scheme::Scheme;
use std::path::{Path, PathBuf};

const ROW: &str = ",1e-5,2e-5,3e-5,0.1,0.2,9.8,0.0,0.5";

fn scratch(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join(name)
}

fn written(name: &str, content: &[u8]) -> PathBuf {
    let path = scratch(name);
    std::fs::write(&path, content).unwrap();
    path
}

fn header() -> String {
    COLUMNS.join(",")
}

/// Everything from opening a log to its end; the message of the first error, without the directory.
fn message_of(path: &Path) -> String {
    let error = match LogReader::open(path) {
        Err(error) => error,
        Ok(rows) => rows.filter_map(Result::err).next().expect("an error"),
    };
    let message = error.to_string();
    assert!(!message.contains('\n'), "{message}");
    message.replace(&format!("{}/", env!("CARGO_TARGET_TMPDIR")), "")
}

fn refused(name: &str, content: &[u8]) -> String {
    message_of(&written(name, content))
}

fn readings(count: u64) -> Vec<Reading> {
    let reading = |index: u64| Reading {
        time_us: 5000 * index + 1,
        omega_g: [1.234_567_891e-5, -0.35, index as f64],
        force_a: [0.1, -9.806_65, 1.0 / 3.0],
        outer_rad: -std::f64::consts::TAU,
        inner_rad: index as f64 / 7.0,
        temperature_c: 20.5,
    };
    (0..count).map(reading).collect()
}

#[test]
fn logs_round_trip_plain_and_compressed() {
    for (name, temperature) in [("round.csv", true), ("round.csv.gz", false)] {
        let path = scratch(name);
        let mut writer = LogWriter::create(&path, temperature).unwrap();
        let sent = readings(10_000);
        sent.iter().for_each(|reading| writer.write(reading).unwrap());
        writer.finish().unwrap();
        let reader = LogReader::open(&path).unwrap();
        assert_eq!(reader.interval_us(), Some(5000));
        let rows: Vec<_> = reader.map(Result::unwrap).collect();
        assert_eq!(rows.len(), sent.len());
        for (index, (row, sent)) in rows.iter().zip(&sent).enumerate() {
            assert_eq!((row.line, row.reading.time_us), (index as u64 + 2, sent.time_us));
            let pairs =
                row.reading.omega_g.iter().zip(&sent.omega_g).chain(row.reading.force_a.iter().zip(&sent.force_a));
            assert!(pairs.into_iter().all(|(a, b)| (a - b).abs() <= 1e-9 * b.abs()));
            assert!((row.reading.inner_rad - sent.inner_rad).abs() <= 1e-12 * sent.inner_rad);
            assert_eq!(row.reading.temperature_c.is_nan(), !temperature);
        }
    }
}

#[test]
fn columns_are_found_by_name() {
    let content = "inner_rad, outer_rad,accel_z_m_s2,accel_y_m_s2,note,accel_x_m_s2,gyro_z_rad_s,gyro_y_rad_s,\
                   gyro_x_rad_s,temperature_c,time_s\r\n8,7,6,5,any,4,3,2,1,,0.5\r\n8,7,6,5,any,4,3,2,1,21.5,0.505\r\n";
    let rows = LogReader::open(&written("order.csv", content.as_bytes())).unwrap();
    let rows: Vec<_> = rows.map(|row| row.unwrap().reading).collect();
    assert_eq!((rows[0].omega_g, rows[0].force_a), ([1.0, 2.0, 3.0], [4.0, 5.0, 6.0]));
    assert_eq!((rows[0].outer_rad, rows[0].inner_rad, rows[0].time_us), (7.0, 8.0, 500_000));
    assert!(rows[0].temperature_c.is_nan());
    assert_eq!(rows[1].temperature_c, 21.5);
}

#[test]
fn wrong_headers_are_named() {
    let lacking = header().replace("gyro_y_rad_s,", "");
    assert_eq!(refused("lacking.csv", lacking.as_bytes()), "lacking.csv:1: column gyro_y_rad_s is missing");
    let twice = header() + ",time_s";
    assert_eq!(refused("twice.csv", twice.as_bytes()), "twice.csv:1: column time_s appears twice, as columns 1 and 10");
    assert_eq!(refused("empty.csv", b""), "empty.csv:1: the file is empty; a header row is required");
    assert_eq!(refused("header.csv", header().as_bytes()), "header.csv:2: no samples after the header row");
    assert_eq!(refused("latin.csv", b"time_s,\xe9\n0,0\n"), "latin.csv:1: column 2: the text is not UTF-8");
    assert!(refused("binary.csv", &[0xff; 100]).starts_with("binary.csv:1: column 1: the text is not UTF-8"));
}

#[test]
fn wrong_rows_are_named() {
    let refused = |name: &str, row: &str| {
        let content = format!("{}\n0.000{ROW}\n0.005{ROW}\n{row}\n", header());
        self::refused(name, content.as_bytes())
    };
    assert_eq!(
        refused("text.csv", "0.01,1,2,oops,4,5,6,7,8"),
        "text.csv:4: column gyro_z_rad_s: \"oops\" is not a number"
    );
    assert_eq!(refused("blank.csv", "0.01,1,,3,4,5,6,7,8"), "blank.csv:4: column gyro_y_rad_s: \"\" is not a number");
    assert_eq!(
        refused("short.csv", "0.01,1,2,3,4,5"),
        "short.csv:4: the row has 6 fields, the header has 9; the first missing column is accel_z_m_s2"
    );
    assert_eq!(
        refused("long.csv", "0.01,1,2,3,4,5,6,7,8,9"),
        "long.csv:4: the row has 10 fields, the header has 9; the first extra column is 10"
    );
    assert_eq!(refused("nan.csv", "0.01,1,2,3,NaN,5,6,7,8"), "nan.csv:4: column accel_x_m_s2: NaN is not finite");
    assert_eq!(refused("inf.csv", "0.01,1,2,3,4,5,6,-inf,8"), "inf.csv:4: column outer_rad: -inf is not finite");
    assert_eq!(
        refused("back.csv", &format!("0.004{ROW}")),
        "back.csv:4: column time_s: time goes back from 5000 to 4000 us"
    );
    assert_eq!(
        refused("early.csv", &format!("-1{ROW}")),
        "early.csv:4: column time_s: the time -1 is not between 0 and 3200000000"
    );
}

#[test]
fn bytes_that_are_not_utf8_are_named() {
    let mut content = format!("{}\n0.000{ROW}\n0.005,", header()).into_bytes();
    content.extend_from_slice(b"1\xff,2,3,4,5,6,7,8\n");
    assert_eq!(refused("bytes.csv", &content), "bytes.csv:3: column gyro_x_rad_s: the text is not UTF-8");
}

#[test]
fn lines_count_blank_ones_and_windows_ends() {
    let content = format!("{}\r\n0.000{ROW}\r\n\r\n\r\n0.005{ROW}\r\nx{ROW}\r\n", header());
    assert_eq!(refused("crlf.csv", content.as_bytes()), "crlf.csv:6: column time_s: \"x\" is not a number");
    let content = format!("{}\n0.000{ROW}\n\n\nx{ROW}\n", header());
    assert_eq!(refused("gap.csv", content.as_bytes()), "gap.csv:5: column time_s: \"x\" is not a number");
}

#[test]
fn paths_that_are_no_logs_are_named() {
    assert!(message_of(&scratch("nowhere.csv")).starts_with("nowhere.csv: No such file"));
    let directory = scratch("directory.csv");
    std::fs::create_dir_all(&directory).unwrap();
    assert_eq!(message_of(&directory), "directory.csv: is a directory");
    let sample = std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("data/sample.csv.gz")).unwrap();
    let cut = refused("cut.csv.gz", &sample[..sample.len() / 2]);
    assert!(cut.starts_with("cut.csv.gz:2") || cut.starts_with("cut.csv.gz:3"), "{cut}");
}

#[test]
fn repeated_times_and_gaps_pass() {
    let rows = ["0.000", "0.005", "0.005", "0.010", "0.500", "0.505"].map(|time| format!("{time}{ROW}\n"));
    let path = written("repeated.csv", (header() + "\n" + &rows.concat()).as_bytes());
    let mut player = LogPlayer::new(LogReader::open(&path).unwrap());
    let mut times = Vec::new();
    for reading in &mut player {
        times.push(reading.time_us);
    }
    assert_eq!(times, [0, 5000, 5000, 10_000, 500_000, 505_000]);
    assert_eq!(player.finish().unwrap(), 6);
    assert_eq!(LogReader::open(&path).unwrap().interval_us(), Some(5000));
}

#[test]
fn a_player_ends_at_the_first_wrong_row() {
    let rows: String = (0..5000).map(|index| format!("{}{ROW}\n", f64::from(index) * 0.005)).collect();
    let path = written("late.csv", format!("{}\n{rows}bad{ROW}\n", header()).as_bytes());
    let mut player = LogPlayer::new(LogReader::open(&path).unwrap());
    assert_eq!(player.by_ref().count(), 5000);
    assert!(player.next().is_none());
    assert!(
        player.finish().unwrap_err().to_string().ends_with("late.csv:5002: column time_s: \"bad\" is not a number")
    );
}

#[test]
fn the_sample_log_parses() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("data");
    let rows = LogReader::open(&data.join("sample.csv.gz")).unwrap();
    assert_eq!(rows.interval_us(), Some(5000));
    let rows: Vec<_> = rows.map(Result::unwrap).collect();
    assert_eq!(rows[0].reading.time_us, 0);
    assert!((rows.last().unwrap().reading.time_us as f64 * 1e-6 - 289.0).abs() < 5.0);
    let config = UnitConfig::read(&data.join("sample.toml")).unwrap();
    assert_eq!(config.site().gravity_m_s2(), 9.807_092_213_717_944);
    assert_eq!(config.noise, Noise::navigation());
    let truth = Truth::read(&data.join("sample.truth.json")).unwrap();
    assert_eq!(truth.parameters.value("Sgzx"), Some(210.0));
    assert_eq!(truth.reachable_sigma.unwrap().value("heading"), Some(0.0239));
}

#[test]
fn truth_round_trips() {
    let path = scratch("truth.json");
    let truth = Truth::new(&real(3));
    truth.write(&path).unwrap();
    assert_eq!(Truth::read(&path).unwrap(), truth);
    std::fs::write(&path, "{\"units\": \"\",\n \"parameters\": {\"Sgxx\": 1}}").unwrap();
    let message = Truth::read(&path).unwrap_err().to_string();
    assert!(message.ends_with("truth.json:2: unknown parameter `Sgxx`"), "{message}");
    std::fs::write(&path, "{\"parameters\": {\"Sgxy\": 1.5, \"heading\": -3}}").unwrap();
    let partial = Truth::read(&path).unwrap();
    let value = |name| partial.parameters.value(name);
    assert_eq!((value("Sgxy"), value("heading"), value("alpha")), (Some(1.5), Some(-3.0), None));
    partial.write(&path).unwrap();
    assert_eq!(Truth::read(&path).unwrap(), partial, "what is not known is not written");
}

#[test]
fn a_unit_says_where_its_numbers_come_from() {
    assert_eq!(
        UnitConfig::default().described(&Default::default()),
        "site: latitude unknown, the gyros find it and gravity; height 0 m, known to 630 ppm (default)\n\
         noise: accelerometers 10.0 ug/sqrt(Hz), gyros 0.00100 deg/sqrt(h), encoders 0.500 arcsec (default)\n\
         hardware: navigation\n"
    );
    let path = written("origin.toml", b"[site]\nlatitude_deg = 45\ngravity_m_s2 = 9.81\n[initial]\nheading_deg = 7\n");
    let (config, origin) = UnitConfig::read_with_origin(&path).unwrap();
    let text = config.described(&origin).replace(&format!("{}/", env!("CARGO_TARGET_TMPDIR")), "");
    let lines: Vec<_> = text.lines().collect();
    assert_eq!(
        lines[0],
        "site: latitude 45 deg, height 0 m, gravity 9.810000 m/s^2 measured, known to 1.02 ppm (origin.toml, height_m by default)"
    );
    assert!(lines[1].ends_with("(default)"), "{text}");
    assert_eq!(lines[3], "heading: 7 +- 1 deg (origin.toml, heading_sigma_deg by default)");
}

fn config_refused(name: &str, text: &str) -> String {
    let message = UnitConfig::read(&written(name, text.as_bytes())).unwrap_err().to_string();
    assert!(!message.contains('\n'), "{message}");
    message.replace(&format!("{}/", env!("CARGO_TARGET_TMPDIR")), "")
}

#[test]
fn unit_files_have_defaults_and_name_what_is_wrong() {
    let path = written("unit.toml", b"[sampling]\nrate_hz = 100\n[initial]\nheading_deg = 30.5\n");
    let config = UnitConfig::read(&path).unwrap();
    assert_eq!(config.sampling.rate_hz, Some(100.0));
    assert_eq!((config.initial.heading_deg, config.initial.heading_sigma_deg), (Some(30.5), 1.0));
    assert_eq!((config.site, config.noise), Default::default());
    let unknown = config_refused("unknown.toml", "[site]\nheight_m = 1\nlatitude = 3\n");
    assert!(unknown.starts_with("unknown.toml:3: unknown field `latitude`, expected one of"), "{unknown}");
    let text = config_refused("text.toml", "[site]\nlatitude_deg = \"north\"\n");
    assert!(text.starts_with("text.toml:2: latitude_deg: invalid type: string"), "{text}");
    let pole = config_refused("pole.toml", "[noise]\n[site]\n\nlatitude_deg = 91\n");
    assert_eq!(pole, "pole.toml:4: latitude_deg: must be from -90 to 90 deg");
    let negative = config_refused("negative.toml", "[noise]\ngyro_arw_deg_sqrt_h = -1.0\n");
    assert_eq!(negative, "negative.toml:2: gyro_arw_deg_sqrt_h: must be finite and not negative");
    let nan = config_refused("nan.toml", "[site]\nlatitude_deg = nan\n");
    assert_eq!(nan, "nan.toml:2: latitude_deg: must be from -90 to 90 deg");
    assert!(config_refused("syntax.toml", "[site]\nlatitude_deg 3\n").starts_with("syntax.toml:2: "));
    assert!(config_refused("none.toml", "[orbit]\n").starts_with("none.toml:1: unknown field `orbit`"));
    assert!(UnitConfig::read(&scratch("nowhere.toml")).unwrap_err().to_string().contains("nowhere.toml: No such"));
}

#[test]
fn schemes_come_by_name_and_from_files() {
    assert_eq!(scheme_named("bai", None, None).unwrap(), Scheme::bai(200.0, 1));
    assert_eq!(scheme_named("bai", Some(10.0), Some(2)).unwrap(), Scheme::bai(10.0, 2));
    let path = scratch("scheme.toml");
    write_scheme(&path, &Scheme::bai(10.0, 2)).unwrap();
    assert_eq!(read_scheme(&path).unwrap(), Scheme::bai(10.0, 2));
    assert_eq!(scheme_named(path.to_str().unwrap(), Some(20.0), None).unwrap(), Scheme::bai(20.0, 2));
    let unknown = scheme_named("bay", None, None).unwrap_err().to_string();
    let names = rins_selfcal::scheme::library::NAMES;
    assert_eq!(unknown, format!("unknown 'bay'; known: {names}, or a file"));
}

#[test]
fn wrong_schemes_are_named() {
    let refused = |name: &str, text: &str| {
        let message = read_scheme(&written(name, text.as_bytes())).unwrap_err().to_string();
        message.replace(&format!("{}/", env!("CARGO_TARGET_TMPDIR")), "")
    };
    let leg = "{ outer_deg = -90, inner_deg = 0, stop_s = 5 }";
    assert_eq!(
        refused("rate.toml", &format!("first_stop_s = 5\nrate_deg_s = 0\nlegs = [{leg}]\n")),
        "rate.toml:2: rate_deg_s: [scheme-motion] rate, acceleration and number of periods must be finite and positive"
    );
    assert_eq!(
        refused("still.toml", &format!("first_stop_s = 5\n\nlegs = [{leg}, {leg}]\n")),
        "still.toml:3: legs: [scheme-leg] leg 2 has an angle that is not finite, or moves neither axis"
    );
    let many = vec![leg; 49].join(",");
    assert_eq!(
        refused("many.toml", &format!("first_stop_s = 5\nlegs = [{many}]\n")),
        "many.toml:2: legs: 49 legs, at most 48 are allowed"
    );
    assert!(refused("stop.toml", &format!("legs = [{leg}]\n")).contains("missing field `first_stop_s`"));
}

#[test]
fn errors_and_noise_come_by_name_and_from_files() {
    assert_eq!(errors_named("real", 4).unwrap().errors, real(4));
    let table3 = errors_named("table3", 0).unwrap();
    assert_eq!((table3.errors.base_roll, table3.errors.gyro_bias_g), (0.0, [0.0; 3]));
    let path = written("errors.toml", b"[parameters]\nalpha = 3600\n[effects]\nlever_arm_m = [0.1, 0.0, 0.0]\n");
    let custom = errors_named(path.to_str().unwrap(), 0).unwrap();
    assert!((custom.errors.mounting[0].to_degrees() - 1.0).abs() < 1e-12);
    assert_eq!(custom.effects.lever_arm_m, [0.1, 0.0, 0.0]);
    let path = written("wrong_errors.toml", b"[parameters]\nalpha = 1\nomega = 2\n");
    let message = errors_named(path.to_str().unwrap(), 0).unwrap_err().to_string();
    assert!(message.contains("unknown parameter `omega`"), "{message}");
    let path = written("limits.toml", b"[parameters]\nalpha = 1\n[effects]\nmax_rate_deg_s = 0.0\n");
    let message = errors_named(path.to_str().unwrap(), 0).unwrap_err().to_string();
    assert!(message.ends_with("limits.toml:4: max_rate_deg_s: must be positive"), "{message}");
    let path = written("infinite.toml", b"[parameters]\nalpha = inf\n");
    let message = errors_named(path.to_str().unwrap(), 0).unwrap_err().to_string();
    assert!(message.ends_with("infinite.toml:2: alpha: must be finite"), "{message}");
    assert!(errors_named("table2", 0).unwrap_err().to_string().ends_with("known: table1, table3, real, or a file"));
    assert_eq!(noise_named("tactical").unwrap(), Noise::tactical());
    let path = written("noise.toml", b"[noise]\nencoder_repeatability_arcsec = 2.0\n");
    assert_eq!(noise_named(path.to_str().unwrap()).unwrap().encoder_repeatability_arcsec, 2.0);
    assert!(noise_named("quiet").is_err());
}
