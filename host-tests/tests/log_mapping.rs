//! Logs with other columns, units and formats: a mapping gives the same readings, and the fault of a wrong mapping is
//! reported.

use host_tests::log::{COLUMNS, LogReader, LogWriter, Mapping};
use host_tests::virtual_unit::plant::Reading;
use parquet::basic::{BrotliLevel, Compression, ZstdLevel};
use parquet::file::metadata::{ParquetMetaDataReader, ParquetMetaDataWriter};
use parquet::file::writer::TrackedWrite;
use rins_selfcal::base::units::{ARCSEC, DEG, DEG_H};
use std::f64::consts::{PI, TAU};
use std::fmt::Write as _;
use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};

const INTERVAL_S: f64 = 0.005;
const G: f64 = 9.806_65;

fn scratch(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("mapping");
    std::fs::create_dir_all(&folder).unwrap();
    folder.join(name)
}

fn written(name: &str, content: impl AsRef<[u8]>) -> PathBuf {
    let path = scratch(name);
    std::fs::write(&path, content).unwrap();
    path
}

/// Readings of axes that turn faster and faster, in both directions.
fn readings() -> Vec<Reading> {
    let reading = |index: u32| {
        let time_s = 2.0 + f64::from(index) * INTERVAL_S;
        Reading {
            time_us: (time_s * 1e6).round() as u64,
            omega_g: [0.1 + time_s, -0.35, 1e-5 * time_s],
            force_a: [0.5, -9.0 + time_s, 1.0 / 3.0],
            outer_rad: 0.3 * time_s,
            inner_rad: -0.2 * time_s,
            temperature_c: 20.5,
        }
    };
    (0..6000).map(reading).collect()
}

fn read(log: &Path, mapping: &str) -> Vec<Reading> {
    let mapping = written(&format!("{}.toml", log.file_name().unwrap().to_str().unwrap()), mapping);
    let layout = Mapping::read(&mapping, log).unwrap();
    LogReader::open_as(log, &layout).unwrap().map(|row| row.unwrap().reading).collect()
}

fn apart_rad(a: f64, b: f64) -> f64 {
    ((a - b + PI).rem_euclid(TAU) - PI).abs()
}

fn assert_same(found: &[Reading], expected: &[Reading], tolerance: f64) {
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(expected) {
        assert_eq!(found.time_us, expected.time_us);
        for (a, b) in found.omega_g.iter().chain(&found.force_a).zip(expected.omega_g.iter().chain(&expected.force_a)) {
            assert!((a - b).abs() <= tolerance, "{found:?} {expected:?}");
        }
        assert!(apart_rad(found.outer_rad, expected.outer_rad) < tolerance, "{found:?} {expected:?}");
        assert!(apart_rad(found.inner_rad, expected.inner_rad) < tolerance, "{found:?} {expected:?}");
        assert!((found.temperature_c - expected.temperature_c).abs() < 1e-4 || expected.temperature_c.is_nan());
    }
}

#[test]
fn text_of_other_units_axes_and_signs() {
    let mut text = String::from("made by another program\nStempel;wx;wy;wz;fx;fy;fz;A;B;T\n");
    for reading in readings() {
        let [gx, gy, gz] = reading.omega_g.map(|omega| omega / DEG_H);
        let [ax, ay, az] = reading.force_a.map(|force| force / G * 1e3);
        // The log's axes: x = -IMU y, y = IMU x, z = IMU z.
        let (gyro, accel) = ([-gy, gx, gz], [-ay, ax, az]);
        let outer = (90.0 - reading.outer_rad / DEG).rem_euclid(360.0);
        let counts = (reading.inner_rad / TAU * 16_777_216.0).rem_euclid(16_777_216.0);
        let mut row = vec![reading.time_us as f64 * 1e-3];
        row.extend(gyro.iter().chain(&accel));
        row.extend([outer, counts, f64::from(reading.temperature_c) + 273.15]);
        let fields: Vec<_> = row.iter().map(|value| format!("{value}").replace('.', ",")).collect();
        writeln!(text, "{}", fields.join(";")).unwrap();
    }
    let log = written("german.csv", text);
    let mapping = "[text]\ndelimiter = \";\"\ndecimal_comma = true\nskip_rows = 1\n\
                   [time]\ncolumn = \"Stempel\"\nunit = \"ms\"\n\
                   [gyro]\ncolumns = [\"wx\", \"wy\", \"wz\"]\nunit = \"deg/h\"\naxes = [\"y\", \"-x\", \"z\"]\n\
                   [accel]\ncolumns = [\"fx\", \"fy\", \"fz\"]\nunit = \"mg\"\naxes = [\"y\", \"-x\", \"z\"]\n\
                   [outer]\ncolumn = \"A\"\nunit = \"deg\"\nzero = 90.0\nreversed = true\n\
                   [inner]\ncolumn = \"B\"\nunit = \"counts\"\ncounts_per_turn = 16777216.0\n\
                   [temperature]\ncolumn = \"T\"\nunit = \"K\"\n";
    // The log has sixteen digits: an error of 1e-16 rad/s for 2e5 deg/h, and of 1e-15 for an angle of one turn.
    assert_same(&read(&log, mapping), &readings(), 1e-12);
}

#[test]
fn increments_of_an_interval_that_ends_at_the_stamp() {
    // The columns of PSINS, `wm vm t`, and the angles at the stamp, which is the end of the interval.
    let mut bytes = Vec::new();
    for reading in readings() {
        let end_s = reading.time_us as f64 * 1e-6 + 0.5 * INTERVAL_S;
        let increments = reading.omega_g.iter().chain(&reading.force_a).map(|rate| rate * INTERVAL_S);
        let row: Vec<f64> = increments.chain([end_s, 0.3 * (end_s), -0.2 * (end_s)]).collect();
        row.iter().for_each(|value| bytes.extend(value.to_le_bytes()));
    }
    let silent = |reading: Reading| Reading { temperature_c: f32::NAN, ..reading };
    let expected: Vec<_> = readings().into_iter().map(silent).collect();
    let log = written("psins.f64", &bytes);
    // For the first row, the angle at the start of its interval is unknown.
    let found = read(&log, "");
    assert!((found[0].outer_rad - expected[0].outer_rad - 0.3 * 0.5 * INTERVAL_S).abs() < 1e-9);
    // A stamp of 30 s has a rounding error of 4e-15 s, and so has the mean interval.
    assert_same(&found[1..], &expected[1..], 1e-9);
    let compressed = scratch("psins.f64.gz");
    let mut encoder = flate2::write::GzEncoder::new(std::fs::File::create(&compressed).unwrap(), Default::default());
    std::io::Write::write_all(&mut encoder, &bytes).unwrap();
    encoder.finish().unwrap();
    assert_same(&read(&compressed, ""), &found, f64::MIN_POSITIVE);
    // A file that is cut within a row, and rows of another length.
    std::fs::write(&log, &bytes[..bytes.len() - 3]).unwrap();
    assert_eq!(
        refused(&log, ""),
        "psins.f64:6000: column 9: the file ends within the row; do its rows have 9 columns?"
    );
}

#[test]
fn single_precision_without_a_time_column() {
    let mut bytes = Vec::new();
    for reading in readings() {
        let ([gx, gy, gz], [ax, ay, az]) = (reading.omega_g, reading.force_a);
        let row = [reading.outer_rad, reading.inner_rad, gx / DEG, gy / DEG, gz / DEG, ax / G, ay / G, az / G];
        row.iter().for_each(|value| bytes.extend((*value as f32).to_le_bytes()));
    }
    let log = written("single.f32", bytes);
    let mapping = "[matrix]\ncolumns = 8\n[time]\nrate_hz = 200.0\nstamp = \"middle\"\n\
                   [gyro]\ncolumns = [3, 4, 5]\nunit = \"deg/s\"\n[accel]\ncolumns = [6, 7, 8]\nunit = \"g\"\n\
                   [outer]\ncolumn = 1\n[inner]\ncolumn = 2\n";
    let counted =
        |(index, reading): (u64, Reading)| Reading { time_us: 5000 * index, temperature_c: f32::NAN, ..reading };
    let expected: Vec<_> = (0..).zip(readings()).map(counted).collect();
    // Rounding to 2^-24 of values up to 40.
    assert_same(&read(&log, mapping), &expected, 3e-6);
}

#[test]
fn angles_of_the_start_are_brought_to_the_middle_over_a_wrap() {
    let mut text = COLUMNS.join(",");
    for reading in readings() {
        let start_s = reading.time_us as f64 * 1e-6 - 0.5 * INTERVAL_S;
        let wrapped = (0.3 * start_s).rem_euclid(TAU);
        let ([gx, gy, gz], [ax, ay, az]) = (reading.omega_g, reading.force_a);
        write!(text, "\n{start_s},{gx},{gy},{gz},{ax},{ay},{az},{wrapped},{}", -0.2 * start_s).unwrap();
    }
    let log = written("start.csv", text);
    let found = read(&log, "[time]\nstamp = \"start\"\n");
    let silent = |reading: Reading| Reading { temperature_c: f32::NAN, ..reading };
    let expected: Vec<_> = readings().into_iter().map(silent).collect();
    assert_same(&found[..5999], &expected[..5999], 1e-9);
    assert!(apart_rad(found[5999].outer_rad, expected[5999].outer_rad - 0.3 * 0.5 * INTERVAL_S) < 1e-9);
}

#[test]
fn parquet_round_trips() {
    for temperature in [true, false] {
        let log = scratch(&format!("round-{temperature}.parquet"));
        let mut writer = LogWriter::create(&log, temperature).unwrap();
        // The log has more rows than one row group, and many batches.
        let sent: Vec<_> = (0..12).flat_map(|_| readings()).collect();
        let later = |(index, reading): (u64, &Reading)| Reading { time_us: 5000 * index, ..*reading };
        let sent: Vec<_> = (0..).zip(&sent).map(later).collect();
        sent.iter().for_each(|reading| writer.write(reading).unwrap());
        writer.finish().unwrap();
        let reader = LogReader::open(&log).unwrap();
        assert_eq!((reader.has_temperature(), reader.interval_us()), (temperature, Some(5000)));
        let found: Vec<_> = reader.map(|row| row.unwrap().reading).collect();
        let known =
            |reading: &Reading| Reading { temperature_c: if temperature { 20.5 } else { f32::NAN }, ..*reading };
        assert_same(&found, &sent.iter().map(known).collect::<Vec<_>>(), 1e-15);
    }
    let text = written("text.parquet", "time_s,gyro_x_rad_s\n");
    assert!(refused(&text, "").starts_with("text.parquet:1: not readable as Parquet: "), "{}", refused(&text, ""));
    let log = scratch("round-true.parquet");
    assert_eq!(refused(&log, "[time]\ncolumn = \"t\"\n"), "round-true.parquet:1: column t is missing");
}

#[test]
fn parquet_codecs_that_are_not_built_in_are_named() {
    let log = scratch("snappy.parquet");
    let mut writer = LogWriter::create(&log, true).unwrap();
    readings().iter().for_each(|reading| writer.write(reading).unwrap());
    writer.finish().unwrap();
    let codecs =
        [(Compression::ZSTD(ZstdLevel::default()), "zstd"), (Compression::BROTLI(BrotliLevel::default()), "brotli")];
    for (codec, name) in codecs {
        let refusal = format!(
            "{name}.parquet:1: column gyro_y_rad_s: compressed with {name}, which is not supported; \
             write the file again with snappy, gzip, lz4 or no compression"
        );
        assert_eq!(refused(&relabelled(&log, &format!("{name}.parquet"), "gyro_y_rad_s", codec), ""), refusal);
        // A column that is not read may have any compression.
        let other = relabelled(&log, &format!("{name}-time.parquet"), "time_s", codec);
        assert_eq!(read(&other, "[time]\nrate_hz = 200.0\n").len(), readings().len());
    }
}

/// A copy of a Parquet file whose metadata name another compression of a column. The pages stay as they are.
fn relabelled(log: &Path, name: &str, column: &str, codec: Compression) -> PathBuf {
    let source = File::open(log).unwrap();
    let mut metadata = ParquetMetaDataReader::new().parse_and_finish(&source).unwrap().into_builder();
    for group in metadata.take_row_groups() {
        let mut group = group.into_builder();
        for chunk in group.take_columns() {
            let same = chunk.column_path().string() != column;
            let chunk = if same { chunk } else { chunk.into_builder().set_compression(codec).build().unwrap() };
            group = group.add_column_metadata(chunk);
        }
        metadata = metadata.add_row_group(group.build().unwrap());
    }
    let path = scratch(name);
    let mut file = TrackedWrite::new(File::create(&path).unwrap());
    // The old footer stays as unused bytes between the pages and the new footer.
    file.write_all(&std::fs::read(log).unwrap()).unwrap();
    ParquetMetaDataWriter::new_with_tracked(file, &metadata.build()).finish().unwrap();
    path
}

/// The line that says what is wrong, without the folder.
fn refused(log: &Path, mapping: &str) -> String {
    let path = written(&format!("{}.toml", log.file_name().unwrap().to_str().unwrap()), mapping);
    let error = match Mapping::read(&path, log).and_then(|layout| LogReader::open_as(log, &layout)) {
        Err(error) => error,
        Ok(rows) => rows.filter_map(Result::err).next().expect("an error"),
    };
    let message = error.to_string();
    assert!(!message.contains('\n'), "{message}");
    message.replace(&scratch("").display().to_string(), "")
}

#[test]
fn wrong_mappings_are_named() {
    let log = scratch("any.csv");
    let refused = |mapping: &str| self::refused(&log, mapping);
    let unknown = refused("[gyro]\nunits = \"deg/s\"\n");
    assert!(unknown.starts_with("any.csv.toml:2: unknown field `units`, expected one of"), "{unknown}");
    assert_eq!(
        refused("[time]\n[gyro]\n\nunit = \"rpm\"\n"),
        "any.csv.toml:4: unit: unknown unit 'rpm'; known: rad/s, deg/s, deg/h, arcsec/s, rad, deg, arcsec"
    );
    assert_eq!(
        refused("[accel]\naxes = [\"x\", \"y\", \"-y\"]\n"),
        "any.csv.toml:2: axes: must be x, y and z in some order, each with or without \"-\""
    );
    assert_eq!(refused("[outer]\nunit = \"counts\"\n"), "any.csv.toml:2: unit: \"counts\" needs counts_per_turn");
    assert_eq!(
        refused("[inner]\nunit = \"deg\"\ncounts_per_turn = 4096.0\n"),
        "any.csv.toml:3: counts_per_turn: is for the unit \"counts\" only, not for \"deg\""
    );
    assert_eq!(refused("[gyro]\nscale = 0.0\n"), "any.csv.toml:2: scale: must be finite and not zero");
    assert_eq!(refused("[time]\nrate_hz = 0.1\n"), "any.csv.toml:2: rate_hz: must be between 1 and 100000");
    assert_eq!(refused("[text]\ndelimiter = \"|\"\n"), "any.csv.toml:2: delimiter: must be \",\", \";\" or \"tab\"");
    assert_eq!(
        refused("[text]\ndecimal_comma = true\n"),
        "any.csv.toml:1: delimiter: must not be \",\" while decimal_comma = true"
    );
    assert_eq!(
        refused("[text]\nheader = false\n[time]\ncolumn = \"t\"\n"),
        "any.csv.toml:4: column: \"t\": the log has no column names; give the number of the column, from 1"
    );
    assert_eq!(
        refused("[outer]\ncolumn = \"a\"\n[inner]\ncolumn = \"a\"\n"),
        "any.csv.toml:4: column: column a is used twice"
    );
    assert!(refused("[inner]\ncolumn = 0\n").contains("any.csv.toml:2: column: columns are counted from 1"));
    assert_eq!(
        refused("format = \"f64\"\n[matrix]\ncolumns = 8\n"),
        "any.csv.toml:1: column: 9 is too large: the matrix has 8 columns"
    );
}

#[test]
fn wrong_rows_of_mapped_logs_are_named() {
    let row = ",1,2,3,4,5,6,7";
    let log = written("nameless.csv", format!("0\t1\n0{row},8\n5{row},8\n10,1,x,3,4,5,6,7,8\n"));
    let mapping = "[text]\nheader = false\nskip_rows = 1\n[time]\ncolumn = 1\nunit = \"ms\"\n\
                   [gyro]\ncolumns = [2, 3, 4]\n[accel]\ncolumns = [5, 6, 7]\n[outer]\ncolumn = 8\n[inner]\ncolumn = 9\n";
    assert_eq!(refused(&log, mapping), "nameless.csv:4: column 3: \"x\" is not a number");
    std::fs::write(&log, format!("#\n0{row},8\n5{row}\n")).unwrap();
    assert_eq!(
        refused(&log, mapping),
        "nameless.csv:3: the row has 8 fields, the first row has 9; the first missing column is 9"
    );
    std::fs::write(&log, format!("#\n0{row},8\n-5{row},8\n")).unwrap();
    assert_eq!(refused(&log, mapping), "nameless.csv:3: column 1: the time -0.005 is not between 0 and 3200000000 s");
    std::fs::write(&log, "#\n0;1;2\n").unwrap();
    assert_eq!(refused(&log, mapping), "nameless.csv:2: the columns are separated by ';', not ','");
    std::fs::write(&log, format!("#\n7{row},8\n")).unwrap();
    let increments = mapping.replace("[accel]", "unit = \"arcsec\"\n[accel]");
    assert_eq!(
        refused(&log, &increments),
        "nameless.csv:2: column 1: the log has no two different times, so the sample interval is unknown; \
        give rate_hz in the mapping"
    );
    let arcsec = read(&log, &increments.replace("unit = \"ms\"", "unit = \"ms\"\nrate_hz = 100.0"));
    assert!((arcsec[0].omega_g[0] - 100.0 * ARCSEC).abs() < 1e-15);
    let degrees = read(&log, &mapping.replace("[accel]", "unit = \"deg/s\"\nscale = -0.5\n[accel]"));
    assert!((degrees[0].omega_g[2] + 1.5 * DEG).abs() < 1e-15);
}

#[test]
fn what_is_damaged_is_named_where_it_is() {
    let rows: Vec<String> = readings()
        .iter()
        .map(|reading| {
            let ([gx, gy, gz], [ax, ay, az]) = (reading.omega_g, reading.force_a);
            let time_s = reading.time_us as f64 * 1e-6;
            format!("{time_s},{gx},{gy},{gz},{ax},{ay},{az},{},{}", reading.outer_rad, reading.inner_rad)
        })
        .collect();
    let with = |number: usize, row: &str| {
        let mut rows = rows.clone();
        rows[number] = row.into();
        format!("{}\n{}\n", COLUMNS.join(","), rows.join("\n"))
    };
    // A number that would become infinite in the computation.
    let log = written("damaged.csv", with(4998, "40.0,0,1e300,0,0,0,9.8,0,0"));
    assert_eq!(
        refused(&log, ""),
        "damaged.csv:5000: column gyro_y_rad_s: 1e300 rad/s is outside the range of any sensor"
    );
    let swapped = "[accel]\naxes = [\"z\", \"x\", \"y\"]\n";
    std::fs::write(&log, with(4998, "40.0,0,0,0,0,-2e15,9.8,0,0")).unwrap();
    assert_eq!(
        refused(&log, swapped),
        "damaged.csv:5000: column accel_y_m_s2: -2e15 m/s^2 is outside the range of any sensor"
    );
    std::fs::write(&log, with(2, "2.01,\"0,0,0,0,0,9.8,0,0")).unwrap();
    assert_eq!(refused(&log, ""), "damaged.csv:4: a quote (\") is not closed");
    std::fs::write(&log, with(2, "2.01,\"0\",0,0,0,0,9.8,0,0")).unwrap();
    assert_eq!(read(&log, "").len(), 6000);
    // A byte in compressed data is damaged. The row is too short because of it, and the message names the damage of the
    // file.
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::none());
    std::io::Write::write_all(&mut encoder, with(0, &rows[0]).as_bytes()).unwrap();
    let mut bytes = encoder.finish().unwrap();
    let middle = bytes.len() / 2;
    let comma = bytes[middle..].iter().position(|byte| *byte == b',').unwrap();
    bytes[middle + comma] = b'x';
    let log = written("damaged.csv.gz", bytes);
    let message = refused(&log, "");
    assert!(message.contains("gzip"), "{message}");
    // Raw matrices are read, not written: no text goes into one.
    let error = LogWriter::create(&scratch("out.f64"), false).err().expect("refused").to_string();
    assert!(
        error.ends_with("out.f64: raw matrices are not written; give a name that ends in .csv, .csv.gz or .parquet")
    );
    assert!(!scratch("out.f64").exists());
}
