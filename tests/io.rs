//! Files: what is written comes back, and what is wrong is said clearly.

use crate::support::data_set::without_checksum;
use hydrograd::io::atomic::{prepare_output_folder, write_atomically, write_bytes_atomically, write_path_atomically};
use hydrograd::io::csv::{read_columns, write_columns, write_table, Cell};
use hydrograd::io::state_file::{read_state, write_state, State};
use hydrograd::io::tensor_file::{write_tensors, Data, TensorFile, Tensors};
use hydrograd::io::tensorboard::EventFile;
use hydrograd::io::vtk::{read_frame, read_list, read_vtp, write_vtp, ParticleFrame, Precision, VtkSeries};
use hydrograd::io::{hdf5_file, FileError};
use proptest::prelude::*;
use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::path::Path;

type TestResult = Result<(), Box<dyn std::error::Error>>;

fn names_in(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// The message of an error, which must hold all of `parts`.
fn message<T: std::fmt::Debug>(result: Result<T, FileError>, parts: &[&str]) -> String {
    let text = result.expect_err("must fail").to_string();
    for part in parts {
        assert!(text.contains(part), "`{part}` is not in: {text}");
    }
    text
}

// --- atomic ---------------------------------------------------------------------------------------------------

#[test]
fn a_failed_write_leaves_the_old_file_and_nothing_else() -> TestResult {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("table.csv");
    write_bytes_atomically(&path, b"old")?;
    let result = write_atomically(&path, |writer| {
        writer.write_all(&[b'x'; 200_000])?;
        Err(std::io::Error::new(std::io::ErrorKind::StorageFull, "no space"))
    });
    message(result, &["table.csv", "no space", "free some space"]);
    let result = write_path_atomically(&path, |temporary| {
        std::fs::write(temporary, "half").unwrap();
        assert_eq!(temporary.parent(), path.parent());
        assert_eq!(temporary.extension().unwrap(), "csv");
        Err(FileError::input(&path, "wrong", "right"))
    });
    message(result, &["wrong", "right"]);
    assert_eq!(std::fs::read(&path)?, b"old");
    assert_eq!(names_in(folder.path()), ["table.csv"]);
    write_bytes_atomically(&path, b"new")?;
    assert_eq!(std::fs::read(&path)?, b"new");
    Ok(())
}

#[test]
fn targets_that_are_no_files_are_refused() -> TestResult {
    let folder = tempfile::tempdir()?;
    message(write_bytes_atomically(folder.path(), b""), &["is a folder", "name of a file"]);
    let text = message(
        write_bytes_atomically(&folder.path().join("missing/file"), b""),
        &["missing/file: entity not found", "its folder exists"],
    );
    assert!(!text.contains("partial"), "{text}");
    assert!(names_in(folder.path()).is_empty());
    Ok(())
}

#[cfg(unix)]
#[test]
fn links_devices_and_permissions() -> TestResult {
    use std::os::unix::fs::PermissionsExt;
    message(write_bytes_atomically(Path::new("/dev/null"), b"x"), &["a device"]);
    let folder = tempfile::tempdir()?;
    let (file, link) = (folder.path().join("file"), folder.path().join("link"));
    std::fs::write(&file, "old")?;
    std::os::unix::fs::symlink(&file, &link)?;
    write_bytes_atomically(&link, b"new")?;
    assert_eq!(std::fs::read(&file)?, b"new");
    assert!(link.is_symlink());
    // As shared as any other new file, not private like a temporary one.
    let plain = folder.path().join("plain");
    std::fs::write(&plain, "")?;
    let mode = |path: &Path| std::fs::metadata(path).map(|data| data.permissions().mode());
    assert_eq!(mode(&file)?, mode(&plain)?);
    Ok(())
}

#[test]
fn output_folders() -> TestResult {
    let folder = tempfile::tempdir()?;
    let nested = folder.path().join("a/b");
    prepare_output_folder(&nested)?;
    prepare_output_folder(&nested)?;
    assert!(nested.is_dir() && names_in(&nested).is_empty());
    let file = folder.path().join("file");
    std::fs::write(&file, "")?;
    message(prepare_output_folder(&file), &["is a file", "another output folder"]);
    message(prepare_output_folder(&file.join("below")), &["file/below"]);
    #[cfg(target_os = "linux")]
    message(prepare_output_folder(Path::new("/proc/self")), &["/proc/self"]);
    Ok(())
}

// --- vtk ------------------------------------------------------------------------------------------------------

const POSITION: [f64; 6] = [0.1, 0.2, 0.3, 1.1, 1.2, 1.3];
const VELOCITY: [f64; 6] = [1.0, 2.0, 3.0, -1.0, -2.0, -3.0];
const TEMPERATURE: [f64; 3] = [1.0, 1.1, 1.23];

fn frame<'a>() -> ParticleFrame<'a> {
    ParticleFrame {
        dimension: 2,
        time: 0.25,
        position: &POSITION,
        velocity: &VELOCITY,
        scalars: &[("temperature", &TEMPERATURE)],
        tag: &[0, 1, 3],
        number: &[],
    }
}

/// Type and raw bytes of an array of a .vtp, found through its offset in the header.
fn appended(bytes: &[u8], name: &str) -> (String, Vec<u8>) {
    let marker = b"<AppendedData encoding=\"raw\">\n_";
    let start = bytes.windows(marker.len()).position(|window| window == marker).unwrap();
    let header = std::str::from_utf8(&bytes[..start]).unwrap();
    let line = header
        .lines()
        .find(|line| line.contains(&format!("Name=\"{name}\"")))
        .unwrap_or_else(|| panic!("{name} in {header}"));
    let value = |key: &str| line.split(&format!("{key}=\"")).nth(1).unwrap().split('"').next().unwrap();
    let at = start + marker.len() + value("offset").parse::<usize>().unwrap();
    let length = u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()) as usize;
    (value("type").to_owned(), bytes[at + 8..at + 8 + length].to_vec())
}

fn reals(bytes: &[u8]) -> Vec<f64> {
    bytes.chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect()
}

#[test]
fn vtp_arrays_are_where_the_header_says() -> TestResult {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("frame.vtp");
    write_vtp(&path, &frame(), Precision::F64)?;
    let bytes = std::fs::read(&path)?;
    let text = String::from_utf8_lossy(&bytes);
    for part in [
        "header_type=\"UInt64\"",
        "byte_order=\"LittleEndian\"",
        "NumberOfPoints=\"3\" NumberOfVerts=\"3\"",
        ">0.25</DataArray>",
    ] {
        assert!(text.contains(part), "{part}");
    }
    let (kind, points) = appended(&bytes, "Points");
    assert_eq!(kind, "Float64");
    assert_eq!(reals(&points), [0.1, 1.1, 0.0, 0.2, 1.2, 0.0, 0.3, 1.3, 0.0]);
    let (_, velocity) = appended(&bytes, "velocity");
    assert_eq!(reals(&velocity), [1.0, -1.0, 0.0, 2.0, -2.0, 0.0, 3.0, -3.0, 0.0]);
    assert_eq!(reals(&appended(&bytes, "temperature").1), TEMPERATURE);
    assert_eq!(appended(&bytes, "tag"), ("UInt8".to_owned(), vec![0, 1, 3]));
    let integers = |name| -> Vec<i64> {
        let (_, raw) = appended(&bytes, name);
        raw.chunks_exact(8).map(|b| i64::from_le_bytes(b.try_into().unwrap())).collect()
    };
    assert_eq!(integers("connectivity"), [0, 1, 2]);
    assert_eq!(integers("offsets"), [1, 2, 3]);
    assert!(bytes.ends_with(b"</AppendedData>\n</VTKFile>\n"));

    write_vtp(&path, &frame(), Precision::F32)?;
    let (kind, temperature) = appended(&std::fs::read(&path)?, "temperature");
    assert_eq!((kind.as_str(), temperature.len()), ("Float32", 12));
    assert_eq!(f32::from_le_bytes(temperature[8..].try_into()?), 1.23_f32);
    Ok(())
}

#[test]
fn vtp_refuses_what_does_not_fit() {
    let path = Path::new("/no-such-folder/x.vtp");
    let write = |frame: ParticleFrame| write_vtp(path, &frame, Precision::F64);
    message(write(ParticleFrame { dimension: 4, ..frame() }), &["dimension is 4", "1, 2 or 3"]);
    message(write(ParticleFrame { velocity: &[1.0], ..frame() }), &["velocity has 1 values", "6 for 3 particles"]);
    message(write(ParticleFrame { position: &[1.0; 5], ..frame() }), &["position has 5 values"]);
    message(write(ParticleFrame { tag: &[0], ..frame() }), &["tag has 1 values"]);
    message(write(ParticleFrame { scalars: &[("tag", &TEMPERATURE)], ..frame() }), &["named `tag`"]);
    message(write(frame()), &["cannot write /no-such-folder/x.vtp"]);
}

#[test]
fn particle_files_are_read_as_they_were_written() -> TestResult {
    let folder = tempfile::tempdir()?;
    let mut series = VtkSeries::new(folder.path(), "a&b")?;
    let path = series.write(&frame())?;
    series.write(&ParticleFrame { time: 0.5, ..frame() })?;
    let frames = read_list(&series.list_path())?;
    assert_eq!(frames.iter().map(|(time, _)| *time).collect::<Vec<_>>(), [0.25, 0.5]);
    assert_eq!(frames[0].1, path);
    let found = read_vtp(&path)?;
    assert_eq!(found.position, [[0.1, 1.1, 0.0], [0.2, 1.2, 0.0], [0.3, 1.3, 0.0]]);
    assert_eq!(found.velocity, [[1.0, -1.0, 0.0], [2.0, -2.0, 0.0], [3.0, -3.0, 0.0]]);
    assert_eq!((found.scalars["temperature"].as_slice(), found.tag.as_slice()), (&TEMPERATURE[..], &[0, 1, 3][..]));
    write_vtp(&path, &frame(), Precision::F32)?;
    assert!((read_vtp(&path)?.velocity[1][0] - 2.0).abs() < 1e-6);
    // Cut short anywhere it is refused.
    let whole = std::fs::read(&path)?;
    for length in [0, 40, whole.len() / 2, whole.len() - 60] {
        std::fs::write(&path, &whole[..length])?;
        message(read_vtp(&path), &["a&b_000000.vtp", "not a readable VTK file"]);
    }
    Ok(())
}

/// Two processes write a frame: it is read as one of all particles, in the order of their numbers.
#[test]
fn pieces_are_read_as_one_frame() -> TestResult {
    let folder = tempfile::tempdir()?;
    let numbers = [[2, 0], [1, 3]];
    let positions = [[2.0, 0.0, 2.5, 0.5], [1.0, 3.0, 1.5, 3.5]];
    let temperatures = [[20.0, 0.25], [10.0, 30.0]];
    let tags = [[2, 0], [1, 3]];
    let mut both = [VtkSeries::new(folder.path(), "a&b")?, VtkSeries::new(folder.path(), "a&b")?];
    for time in [0.25, 0.5] {
        let scalars = temperatures.each_ref().map(|of| [("temperature", of.as_slice())]);
        let frame = |k: usize| ParticleFrame {
            dimension: 2,
            time,
            position: &positions[k],
            velocity: &[],
            scalars: &scalars[k],
            tag: &tags[k],
            number: &numbers[k],
        };
        for (k, series) in both.iter().enumerate() {
            series.write_piece(&frame(k), k)?;
        }
        for (k, series) in both.iter_mut().enumerate() {
            series.join(&frame(k), 2, k == 0)?;
        }
    }
    let frames = read_list(&both[0].list_path())?;
    let names = ["a&b_000000.pvtp", "a&b_000001.pvtp"].map(|name| folder.path().join(name));
    assert_eq!(frames.iter().map(|(_, path)| path).collect::<Vec<_>>(), names.iter().collect::<Vec<_>>());
    let found = read_frame(&names[1])?;
    assert_eq!(found.position, [[0.0, 0.5, 0.0], [1.0, 1.5, 0.0], [2.0, 2.5, 0.0], [3.0, 3.5, 0.0]]);
    assert_eq!((&found.scalars["temperature"][..], &found.tag[..]), (&[0.25, 10.0, 20.0, 30.0][..], &[0, 1, 2, 3][..]));
    assert!(found.velocity.is_empty() && found.number == [0, 1, 2, 3]);
    // A piece that is gone is named.
    std::fs::remove_file(folder.path().join("a&b_000001_1.vtp"))?;
    message(read_frame(&names[1]), &["a&b_000001_1.vtp"]);
    Ok(())
}

#[test]
fn the_series_list_is_complete_after_every_frame() -> TestResult {
    let folder = tempfile::tempdir()?;
    let mut series = VtkSeries::new(&folder.path().join("vtk"), "a&b")?;
    series.write(&frame())?;
    let one = std::fs::read_to_string(series.list_path())?;
    assert!(one.contains("timestep=\"0.25\"") && one.contains("file=\"a&amp;b_000000.vtp\""), "{one}");
    assert!(one.ends_with("</VTKFile>\n"));
    let path = series.write(&ParticleFrame { time: 1e-7, ..frame() })?;
    assert!(path.ends_with("a&b_000001.vtp") && path.is_file());
    let two = std::fs::read_to_string(series.list_path())?;
    assert_eq!(two.matches("<DataSet").count(), 2);
    assert!(two.contains("timestep=\"1e-7\""));
    assert_eq!(names_in(&folder.path().join("vtk")), ["a&b.pvd", "a&b_000000.vtp", "a&b_000001.vtp"]);
    message(VtkSeries::new(folder.path(), "a/b"), &["`a/b`", "plain file name"]);
    Ok(())
}

// --- state ----------------------------------------------------------------------------------------------------

fn state(count: usize) -> State {
    let values = |factor: f64| (0..count).map(|i| factor * (i as f64).sin()).collect::<Vec<f64>>();
    State {
        dimension: 2,
        position: [values(1.0), values(0.3)].concat(),
        velocity: Some([values(2.0), values(0.7)].concat()),
        temperature: Some(values(1.23)),
        density: Some(values(0.99)),
        pressure: Some(values(1e-300)),
        mass: Some(values(4e-4)),
        tag: Some((0..count).map(|i| (i % 4) as u8).collect()),
        time: 0.1 + 0.2,
        step: 12_345,
        box_size: vec![1.0, 0.32],
        dx: 0.02,
        configuration: "[fluid]\nviscosity = 0.01 # µ\n".repeat(5000),
        version: "0.1.0".to_owned(),
        seed: u64::MAX,
    }
}

#[test]
fn a_state_comes_back_bit_for_bit() -> TestResult {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("state.h5");
    // More than one chunk, none, and a state with positions only.
    let mut bare = state(5);
    bare.velocity = None;
    bare.temperature = None;
    bare.density = None;
    bare.pressure = None;
    bare.mass = None;
    bare.tag = None;
    for written in [state(20_000), state(0), bare] {
        write_state(&path, &written)?;
        assert_eq!(read_state(&path, &[])?, written);
        assert_eq!(names_in(folder.path()), ["state.h5"]);
    }
    message(read_state(&path, &["temperature"]), &["state.h5", "no dataset `temperature`", "it has: position"]);
    Ok(())
}

/// HDF5 locks what it writes, and a program that is started meanwhile keeps the file open.
#[test]
fn a_file_can_be_read_while_a_program_runs_that_was_started_when_it_was_written() -> TestResult {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("state.h5");
    let mut started = None;
    hdf5_file::write_file(&path, |_| {
        started = Some(std::process::Command::new("sleep").arg("100").spawn().expect("a program"));
        Ok(())
    })?;
    let found = hdf5_file::open(&path, "state").map(|_| ());
    let mut program = started.expect("it was written");
    let ended = program.kill();
    program.wait()?;
    ended?;
    Ok(found?)
}

#[test]
fn a_state_is_compressed_and_particle_major() -> TestResult {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("state.h5");
    let mut written = state(3);
    written.position = POSITION.to_vec();
    write_state(&path, &written)?;
    let file = hdf5::File::open(&path)?;
    let position = file.dataset("position")?;
    assert_eq!(position.shape(), [3, 2]);
    assert_eq!(position.read_raw::<f64>()?, [0.1, 1.1, 0.2, 1.2, 0.3, 1.3]);
    use hdf5::filters::Filter;
    assert_eq!(position.filters(), [Filter::Shuffle, Filter::Deflate(4), Filter::Fletcher32]);
    Ok(())
}

#[test]
fn states_that_cannot_be_read_say_why() -> TestResult {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("state.h5");
    message(read_state(&path, &[]), &["cannot read", "state.h5", "spelling"]);
    write_state(&path, &state(2000))?;
    let bytes = std::fs::read(&path)?;
    for length in [bytes.len() - 100, bytes.len() / 2, 100, 0] {
        std::fs::write(&path, &bytes[..length])?;
        let text = message(read_state(&path, &[]), &["state.h5", "HDF5", "cut short"]);
        assert!(text.len() < 600, "{text}");
    }
    std::fs::write(&path, "x, y\n1, 2\n")?;
    message(read_state(&path, &[]), &["another format"]);

    write_state(&path, &state(5))?;
    let other = std::fs::File::open(&path)?;
    other.lock()?;
    message(read_state(&path, &[]), &["state.h5 is locked", "wait", "HDF5_USE_FILE_LOCKING"]);
    drop(other);
    read_state(&path, &[])?;

    let change = |edit: &dyn Fn(&hdf5::File) -> hdf5::Result<()>| {
        write_state(&path, &state(5)).unwrap();
        without_checksum(&path);
        edit(&hdf5::File::open_rw(&path).unwrap()).unwrap();
        read_state(&path, &[])
    };
    let replace = |name: &'static str, shape: &'static [usize]| {
        move |file: &hdf5::File| {
            file.unlink(name)?;
            file.new_dataset::<f64>().shape(shape).create(name).map(drop)
        }
    };
    message(change(&replace("temperature", &[4])), &["`temperature` is of shape [4]", "of shape [5]"]);
    message(change(&replace("position", &[5, 4])), &["`position`", "[5, 4]", "[N, 2]"]);
    message(change(&|file| file.unlink("position")), &["no dataset `position`", "velocity"]);
    message(change(&|file| file.delete_attr("dx")), &["no attribute `dx`", "box_size"]);
    Ok(())
}

#[test]
fn a_state_that_does_not_fit_together_is_not_written() {
    let path = Path::new("/no-such-folder/state.h5");
    let mut wrong = state(3);
    wrong.mass = Some(vec![1.0]);
    message(write_state(path, &wrong), &["mass has 1 values", "3 for 3 particles", "nothing was written"]);
    let mut wrong = state(3);
    wrong.box_size = vec![1.0];
    message(write_state(path, &wrong), &["box_size has 1 values"]);
    message(write_state(path, &state(3)), &["cannot write", "its folder exists"]);
}

// --- tables ---------------------------------------------------------------------------------------------------

proptest! {
    #[test]
    fn numbers_survive_a_table(values in prop::collection::vec(proptest::num::f64::NORMAL | proptest::num::f64::SUBNORMAL | proptest::num::f64::ZERO, 1..30)) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.csv");
        let index: Vec<f64> = (0..values.len()).map(|i| i as f64).collect();
        write_columns(&path, &[("index", &index), ("value, quoted \"x\"", &values)]).unwrap();
        let back = read_columns(&path, &["value, quoted \"x\"", "index"]).unwrap();
        let bits = |values: &[f64]| values.iter().map(|v| v.to_bits()).collect::<Vec<u64>>();
        prop_assert_eq!(bits(&back[0]), bits(&values));
        prop_assert_eq!(&back[1], &index);
    }
}

#[test]
fn tables_with_mixed_cells() -> TestResult {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("history.csv");
    let rows = vec![
        vec![Cell::from(0_usize), Cell::from(0.1), Cell::from("start, flat")],
        vec![Cell::from(1_usize), Cell::from(1e-300), Cell::from("two\nlines")],
    ];
    write_table(&path, &["epoch", "q", "note"], &rows)?;
    assert_eq!(std::fs::read_to_string(&path)?, "epoch,q,note\n0,0.1,\"start, flat\"\n1,1e-300,two lines\n");
    assert_eq!(read_columns(&path, &["q", "epoch"])?, [[0.1, 1e-300], [0.0, 1.0]]);
    message(write_table(&path, &["epoch"], &rows), &["row 1 has 3 cells", "1 cells, as in the header"]);
    message(write_columns(&path, &[("a", &[1.0]), ("b", &[])]), &["column `b` has 0 values"]);
    Ok(())
}

#[test]
fn tables_from_elsewhere_are_read_with_care() -> TestResult {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("shape.csv");
    let read = |text: &str| {
        std::fs::write(&path, text).unwrap();
        read_columns(&path, &["x", "offset"])
    };
    let good = "\u{feff}# a shape\r\n x , offset\r\n\r\n0.26, -0.01\r\n# more\r\n0.28, +2e-2\r\n";
    assert_eq!(read(good)?, [[0.26, 0.28], [-0.01, 0.02]]);
    message(read("x,y\n1,2\n"), &["shape.csv", "no column `offset`", "it has: x, y"]);
    message(read("x;offset\n1;2\n"), &["no column `x`", "not semicolons"]);
    message(
        read("x,offset\n1,2\n\n3,abc\n"),
        &["shape.csv, line 4, column `offset`", "`abc` is not a number", "allowed: finite numbers"],
    );
    message(read("x,offset\n1,NaN\n"), &["line 2", "NaN"]);
    message(read("x,offset\n-inf,1\n"), &["line 2, column `x`", "infinite"]);
    message(read("x,offset\n1,\n"), &["`` is empty"]);
    message(read("x,offset\n1,2,3\n"), &["line 2", "3 cells", "2 cells, as in the header"]);
    message(read("x,x,offset\n1,2,3\n"), &["`x`", "two columns", "rename"]);
    message(read(""), &["empty"]);
    message(read("# nothing\n\n"), &["empty"]);
    message(read("x,offset\n"), &["no rows"]);
    std::fs::write(&path, [0xff, 0xfe, 0x00])?;
    message(read_columns(&path, &["x"]), &["not UTF-8"]);
    message(read_columns(&folder.path().join("no.csv"), &["x"]), &["cannot read", "no.csv", "spelling"]);
    Ok(())
}

// --- tensors --------------------------------------------------------------------------------------------------

fn tensors() -> (Tensors, BTreeMap<String, String>) {
    let tensors = [
        ("a_single", vec![3], Data::F32(vec![0.1, -3.25e38, 7.0])),
        ("position", vec![2, 3], Data::F64(vec![0.1, 1e-310, -0.0, f64::NAN, f64::INFINITY, 6.0])),
        ("counter", vec![], Data::U64(vec![u64::MAX])),
        ("empty", vec![0, 4], Data::F64(vec![])),
    ];
    let metadata = [("config", "[a]\nb = \"µ\""), ("version", "0.1.0"), ("z", "")];
    (
        tensors.into_iter().map(|(name, shape, data)| (name.to_owned(), (shape, data))).collect(),
        metadata.map(|(key, value)| (key.to_owned(), value.to_owned())).into(),
    )
}

#[test]
fn tensors_come_back_bit_for_bit() -> TestResult {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("checkpoint.safetensors");
    let (tensors, metadata) = tensors();
    write_tensors(&path, &tensors, &metadata)?;
    let bytes = std::fs::read(&path)?;
    let back = TensorFile::read(&path)?;
    assert_eq!(back.metadata, metadata);
    assert_eq!(back.tensors.keys().collect::<Vec<_>>(), tensors.keys().collect::<Vec<_>>());
    let bits = |values: &[f64]| values.iter().map(|v| v.to_bits()).collect::<Vec<u64>>();
    let Data::F64(position) = &tensors["position"].1 else { panic!() };
    assert_eq!(bits(back.f64("position", &[2, 3])?), bits(position));
    assert_eq!(back.tensors["a_single"], (vec![3], Data::F32(vec![0.1, -3.25e38, 7.0])));
    assert_eq!(back.tensors["counter"], (vec![], Data::U64(vec![u64::MAX])));
    assert!(back.f64("empty", &[0, 4])?.is_empty());
    assert_eq!(back.text("version")?, "0.1.0");
    assert_eq!(back.shape("position")?, [2, 3]);
    // Wide elements stand at multiples of their size, whatever the names.
    let length = u64::from_le_bytes(bytes[..8].try_into()?) as usize;
    let header: serde_json::Value = serde_json::from_slice(&bytes[8..8 + length])?;
    assert_eq!(length % 8, 0);
    assert_eq!(header["position"]["data_offsets"][0].as_u64().unwrap() % 8, 0);
    // Equal contents, equal bytes; no metadata is fine too.
    write_tensors(&path, &back.tensors, &back.metadata)?;
    assert_eq!(std::fs::read(&path)?, bytes);
    write_tensors(&path, &Tensors::new(), &BTreeMap::new())?;
    assert!(TensorFile::read(&path)?.tensors.is_empty());
    Ok(())
}

#[test]
fn tensor_files_that_do_not_fit_say_why() -> TestResult {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("checkpoint.safetensors");
    message(TensorFile::read(&path), &["cannot read", "checkpoint.safetensors"]);
    let (tensors, metadata) = tensors();
    write_tensors(&path, &tensors, &metadata)?;
    let file = TensorFile::read(&path)?;
    message(file.f64("velocity", &[1]), &["no tensor `velocity`", "a_single, counter, empty, position"]);
    message(file.f64("position", &[3, 2]), &["of shape [2, 3]", "must be of shape [3, 2]"]);
    message(file.f64("counter", &[]), &["a tensor of U64", "of F64"]);
    message(file.f64("a_single", &[3]), &["a tensor of F32", "of F64"]);
    message(file.text("seed"), &["no metadata entry `seed`", "config, version, z"]);

    let bytes = std::fs::read(&path)?;
    for length in [bytes.len() - 1, 50, 3, 0] {
        std::fs::write(&path, &bytes[..length])?;
        message(TensorFile::read(&path), &["checkpoint.safetensors", "cut short", "earlier checkpoint"]);
    }
    // A type that we do not use.
    let header = br#"{"a":{"dtype":"I16","shape":[2],"data_offsets":[0,4]}}"#;
    let foreign = [&(header.len() as u64).to_le_bytes()[..], header, &[0; 4]].concat();
    std::fs::write(&path, foreign)?;
    message(TensorFile::read(&path), &["`a` is a tensor of I16", "F64, F32, U64, I64 or I32"]);

    let write = |name: &str, shape: Vec<usize>| {
        let tensors = Tensors::from([(name.to_owned(), (shape, Data::F64(vec![1.0])))]);
        write_tensors(&path, &tensors, &BTreeMap::new())
    };
    message(write("a", vec![2]), &["tensor `a` has shape [2] but 1 elements", "2 elements"]);
    message(write("__metadata__", vec![1]), &["__metadata__"]);
    Ok(())
}

/// Writes samples for scripts/check_vtk.py when HYDROGRAD_SAMPLES names a folder.
#[test]
fn samples_for_python() -> TestResult {
    let Some(folder) = std::env::var_os("HYDROGRAD_SAMPLES") else {
        return Ok(());
    };
    let folder = Path::new(&folder);
    let mut series = VtkSeries::new(folder, "series")?;
    series.write(&frame())?;
    series.write(&ParticleFrame { time: 0.75, ..frame() })?;
    let position = [POSITION, POSITION].concat();
    let three = ParticleFrame { dimension: 3, position: &position[..9], velocity: &position[3..], ..frame() };
    write_vtp(&folder.join("three.vtp"), &three, Precision::F32)?;
    let none = ParticleFrame { position: &[], velocity: &[], scalars: &[], tag: &[], ..frame() };
    write_vtp(&folder.join("none.vtp"), &none, Precision::F64)?;
    write_state(&folder.join("state.h5"), &state(2000))?;
    let (tensors, metadata) = tensors();
    write_tensors(&folder.join("checkpoint.safetensors"), &tensors, &metadata)?;
    Ok(())
}

#[test]
fn a_changed_byte_of_hdf5_is_found_wherever_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.h5");
    hdf5_file::write_file(&path, |file| hdf5_file::write_dataset(&path, file, "numbers", &[50], &[1.5f64; 50]))
        .unwrap();
    let numbers = |path: &Path| -> Vec<f64> {
        hdf5_file::open(path, "file").unwrap().dataset("numbers").unwrap().read_raw().unwrap()
    };
    assert_eq!(numbers(&path), [1.5; 50]);
    let whole = fs::read(&path).unwrap();
    let is_refused = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        matches!(hdf5_file::open(&path, "file"), Err(FileError::Damaged { what, .. }) if what.contains("checksum"))
    };
    // The text of the user block is followed by zeros, and the block by what HDF5 wrote.
    let mark = whole.iter().position(|&byte| byte == b'\n').unwrap() + 1;
    let end = whole.iter().position(|&byte| byte == 0).unwrap();
    for place in (mark..end).chain(512..whole.len()) {
        let mut bytes = whole.clone();
        bytes[place] ^= 4;
        assert!(is_refused(&bytes), "byte {place} of {}", whole.len());
    }
    for length in [511, 512, whole.len() - 1] {
        assert!(is_refused(&whole[..length]), "cut to {length}");
    }
    // What does not begin so is HDF5 as any other.
    let mut other = whole.clone();
    other[0] = 0;
    fs::write(&path, other).unwrap();
    assert_eq!(numbers(&path), [1.5; 50]);
}

#[test]
fn a_changed_byte_of_tensors_or_metadata_is_found_wherever_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.safetensors");
    let metadata =
        BTreeMap::from([("best_epoch".to_owned(), "5".to_owned()), ("config".to_owned(), "a = \"b\"".to_owned())]);
    let tensors = Tensors::from([("a".to_owned(), (vec![3], Data::F64(vec![1.5; 3])))]);
    write_tensors(&path, &tensors, &metadata).unwrap();
    let found = TensorFile::read(&path).unwrap();
    assert_eq!((found.tensors, found.metadata), (tensors, metadata.into_iter().collect()));
    let whole = fs::read(&path).unwrap();
    let name = b"\"checksum\":";
    let name_at = whole.windows(name.len()).position(|part| part == name).unwrap();
    for place in (0..whole.len()).filter(|place| !(name_at..name_at + name.len()).contains(place)) {
        let mut bytes = whole.clone();
        bytes[place] ^= 1;
        assert!(TensorFile::parse(&path, &bytes).is_err(), "byte {place} of {}", whole.len());
    }
    // A file of version 0.1.0, whose checksum is that of its tensors.
    let body = [1.5f64; 3].map(f64::to_le_bytes).concat();
    let sum = crc32c::crc32c(&body);
    let header = format!(
        r#"{{"__metadata__":{{"best_epoch":"5","crc32c":"{sum:08x}"}},"a":{{"dtype":"F64","shape":[3],"data_offsets":[0,24]}}}}"#
    );
    let mut old = [&(header.len() as u64).to_le_bytes()[..], header.as_bytes(), &body].concat();
    let found = TensorFile::parse(&path, &old).unwrap();
    assert_eq!(found.metadata, BTreeMap::from([("best_epoch".to_owned(), "5".to_owned())]));
    let last = old.len() - 1;
    old[last] ^= 1;
    assert!(TensorFile::parse(&path, &old).is_err());
}

#[test]
fn a_full_disk_is_one_line_of_hdf5() {
    let text =
        "H5F__close_cb(): can't close file: file write failed: time = Mon Nov 23 00:54:54 2026\n, filename = 'a.h5', \
                file descriptor = 3, errno = 28, error message = 'No space left on device', buf = 0x55f0";
    let failed = |text: &str| hdf5_file::failed(Path::new("a.h5"), "write")("the end of the file")(text.into());
    let found = failed(text);
    assert!(
        matches!(&found, FileError::Write { source, .. } if source.kind() == std::io::ErrorKind::StorageFull),
        "{found:?}"
    );
    assert!(matches!(failed("no such dataset"), FileError::Hdf5 { .. }));
}

#[test]
fn a_record_of_tensorboard_by_hand() {
    // CRC-32C of "123456789" is 0xe3069283 (the Castagnoli check value); the mask is TensorFlow's.
    assert_eq!(crc32c::crc32c(b"123456789"), 0xe306_9283);
    let masked = |data: &[u8]| crc32c::crc32c(data).rotate_right(15).wrapping_add(0xa282_ead8);
    let folder = tempfile::tempdir().unwrap();
    let mut events = EventFile::create(folder.path()).unwrap();
    events.scalars(300, &[("loss", 0.5)]).unwrap();
    let file = std::fs::read(folder.path().join(&names_in(folder.path())[0])).unwrap();
    let length = u64::from_le_bytes(file[..8].try_into().unwrap()) as usize;
    let second = &file[16 + length..];
    let length = u64::from_le_bytes(second[..8].try_into().unwrap()) as usize;
    let data = &second[12..12 + length];
    assert_eq!(masked(data).to_le_bytes(), second[12 + length..]);
    // Behind the time: step 300 in seven bits a byte, then a summary of one value.
    assert_eq!(data[9..12], [0x10, 0xac, 0x02]);
    assert_eq!(data[12..], [&[0x2a, 13, 0x0a, 11, 0x0a, 4][..], b"loss", &[0x15], &0.5f32.to_le_bytes()].concat());
}
