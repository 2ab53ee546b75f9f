//! Compiles the rotation scheme of a TOML file, named by the environment variable `RINS_SCHEME`, into the core: the
//! firmware then runs it where nothing else is configured. Format: `rins plan` writes it, the README shows it. Angles and
//! times are checked by the core, on the host and at power-up; here the file only has to be one.
//!
//! Gives the linker the memory of the board that the firmware is built for.

#[path = "src/scheme/limits.rs"]
mod limits;
#[path = "src/scheme/table.rs"]
mod table;

use limits::{MAX_LEGS, MAX_NAME_BYTES};
use std::path::Path;
use std::{env, fs};
use table::SchemeTable;

const VARIABLE: &str = "RINS_SCHEME";

/// Feature of a board, folder of its memory, its processor.
const BOARDS: [[&str; 3]; 3] = [
    ["mps2-an500", "src/bin/firmware/mps2", "cortex-m7"],
    ["mps2-an386", "src/bin/firmware/mps2", "cortex-m4"],
    ["stm32h743", "src/bin/firmware/stm32h743", "cortex-m7"],
];

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed=src/scheme/limits.rs");
    println!("cargo:rerun-if-changed=src/scheme/table.rs");
    compile_scheme();
    if env::var("CARGO_CFG_TARGET_OS").is_ok_and(|system| system == "none") && has_feature("firmware") {
        link_board().unwrap_or_else(|error| println!("cargo::error={error}"));
    }
}

fn has_feature(name: &str) -> bool {
    env::var_os(format!("CARGO_FEATURE_{}", name.to_uppercase().replace('-', "_"))).is_some()
}

/// Lets the linker find the `regions.x` of the one board, which `memory.x` includes.
fn link_board() -> Result<(), String> {
    let chosen: Vec<_> = BOARDS.iter().filter(|[name, ..]| has_feature(name)).collect();
    let [[name, folder, processor]] = chosen.as_slice() else {
        let names = BOARDS.map(|[name, ..]| name).join(", ");
        return Err(format!("the firmware is for one board; choose one feature of: {names}"));
    };
    let flags = env::var("CARGO_ENCODED_RUSTFLAGS").unwrap_or_default();
    let built_for = flags.rsplit("target-cpu=").next().and_then(|rest| rest.split('\x1f').next());
    if built_for != Some(processor) {
        return Err(format!("{name} needs the flag target-cpu={processor} to come last, see .cargo"));
    }
    println!("cargo:rerun-if-changed=memory.x");
    println!("cargo:rerun-if-changed={folder}/regions.x");
    let root = env::var("CARGO_MANIFEST_DIR").map_err(|error| error.to_string())?;
    println!("cargo:rustc-link-search={root}/{folder}");
    for argument in ["--nmagic", "-Tlink.x", "-Tdefmt.x"] {
        println!("cargo:rustc-link-arg-bin=firmware={argument}");
        println!("cargo:rustc-link-arg-examples={argument}");
    }
    Ok(())
}

fn compile_scheme() {
    println!("cargo:rerun-if-env-changed={VARIABLE}");
    let path = env::var(VARIABLE).ok().filter(|path| !path.is_empty());
    let code =
        path.map_or(Ok("None".into()), |path| expression(&path).map_err(|error| format!("{VARIABLE}={path}: {error}")));
    let code = code.unwrap_or_else(|error| {
        // Cargo shows it and fails.
        println!("cargo::error={}", error.split_whitespace().collect::<Vec<_>>().join(" "));
        "None".into()
    });
    let folder = env::var("OUT_DIR").expect("cargo sets it");
    fs::write(Path::new(&folder).join("compiled_scheme.rs"), code).expect("cargo's folder can be written");
}

/// The scheme as a Rust expression, or what is wrong with the file.
fn expression(path: &str) -> Result<String, String> {
    println!("cargo:rerun-if-changed={path}");
    let text = fs::read_to_string(path).map_err(|error| error.to_string())?;
    let scheme: SchemeTable = toml::from_str(&text).map_err(|error| error.to_string())?;
    let name = scheme.name_or(Path::new(path));
    let SchemeTable { rate_deg_s, acceleration_deg_s2, first_stop_s, periods, legs, .. } = scheme;
    let numbers = legs.iter().flat_map(|leg| [leg.outer_deg, leg.inner_deg, leg.stop_s]);
    let all = [rate_deg_s, acceleration_deg_s2, first_stop_s].into_iter().chain(numbers);
    if !all.into_iter().all(f64::is_finite) {
        return Err("a number is not finite".into());
    }
    if name.len() > MAX_NAME_BYTES {
        return Err(format!("the name has more than {MAX_NAME_BYTES} bytes"));
    }
    if legs.len() > MAX_LEGS {
        return Err(format!("{} legs, at most {MAX_LEGS} fit", legs.len()));
    }
    let legs: Vec<_> = legs.iter().map(|leg| (leg.outer_deg, leg.inner_deg, leg.stop_s)).collect();
    Ok(format!(
        "Some(of_file({name:?}, [{rate_deg_s:?}, {acceleration_deg_s2:?}], {first_stop_s:?}, {periods}, &{legs:?}))"
    ))
}
