//! Compiles a rotation scheme into the core. The environment variable `RINS_SCHEME` names the TOML file of the scheme.
//! The firmware runs this scheme if no other scheme is configured. `rins plan` writes such files, and the README shows
//! the format. This script checks only the form of the file; the core checks angles and times, on the host and at
//! power-up.
//!
//! For the firmware, this script also gives the linker the memory regions of the selected board.

#[path = "src/scheme/limits.rs"]
mod limits;
#[path = "src/scheme/table.rs"]
mod table;

use limits::{MAX_LEGS, MAX_NAME_BYTES};
use std::path::Path;
use std::{env, fs};
use table::SchemeTable;

const VARIABLE: &str = "RINS_SCHEME";

/// For each board: its feature, the folder of its memory regions, its processor.
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

/// Adds the folder of the selected board to the linker's search path, so that `memory.x` finds `regions.x`.
fn link_board() -> Result<(), String> {
    let chosen: Vec<_> = BOARDS.iter().filter(|[name, ..]| has_feature(name)).collect();
    let [[name, folder, processor]] = chosen.as_slice() else {
        let names = BOARDS.map(|[name, ..]| name).join(", ");
        return Err(format!("the firmware needs exactly one board; choose one of the features {names}"));
    };
    let flags = env::var("CARGO_ENCODED_RUSTFLAGS").unwrap_or_default();
    let built_for = flags.rsplit("target-cpu=").next().and_then(|rest| rest.split('\x1f').next());
    if built_for != Some(processor) {
        return Err(format!(
            "{name} needs the compiler flag target-cpu={processor}; see .cargo/config.toml and .cargo/cortex-m4.toml"
        ));
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
        // Cargo prints this line and fails the build.
        println!("cargo::error={}", error.split_whitespace().collect::<Vec<_>>().join(" "));
        "None".into()
    });
    let folder = env::var("OUT_DIR").expect("cargo sets OUT_DIR");
    fs::write(Path::new(&folder).join("compiled_scheme.rs"), code).expect("OUT_DIR is writable");
}

/// The scheme in the file as a Rust expression, or a message that says what is wrong with the file.
fn expression(path: &str) -> Result<String, String> {
    println!("cargo:rerun-if-changed={path}");
    let text = fs::read_to_string(path).map_err(|error| error.to_string())?;
    let scheme: SchemeTable = toml::from_str(&text).map_err(|error| error.to_string())?;
    let name = scheme.name_or(Path::new(path));
    let SchemeTable { rate_deg_s, acceleration_deg_s2, first_stop_s, periods, legs, .. } = scheme;
    let numbers = legs.iter().flat_map(|leg| [leg.outer_deg, leg.inner_deg, leg.stop_s]);
    let all = [rate_deg_s, acceleration_deg_s2, first_stop_s].into_iter().chain(numbers);
    if !all.into_iter().all(f64::is_finite) {
        return Err("every number must be finite".into());
    }
    if name.len() > MAX_NAME_BYTES {
        return Err(format!("the name has more than {MAX_NAME_BYTES} bytes"));
    }
    if legs.len() > MAX_LEGS {
        return Err(format!("{} legs, but a scheme has at most {MAX_LEGS}", legs.len()));
    }
    let legs: Vec<_> = legs.iter().map(|leg| (leg.outer_deg, leg.inner_deg, leg.stop_s)).collect();
    Ok(format!(
        "Some(of_file({name:?}, [{rate_deg_s:?}, {acceleration_deg_s2:?}], {first_stop_s:?}, {periods}, &{legs:?}))"
    ))
}
