//! The program with a driver whose compiler never finishes.

use crate::common;
use crate::place::Place;
use std::fs;
use std::path::PathBuf;
use std::process::Command;

fn loader() -> PathBuf {
    let known = Command::new("/sbin/ldconfig").arg("-p").output().expect("ldconfig runs").stdout;
    let known = String::from_utf8_lossy(&known).into_owned();
    let line = known.lines().find(|line| line.contains("libvulkan.so.1")).expect("a Vulkan loader");
    line.rsplit(" => ").next().expect("a path").into()
}

#[test]
fn a_command_ends_with_an_error_although_the_drivers_compiler_never_does() {
    const TEST: &str = "a_command_ends_with_an_error_although_the_drivers_compiler_never_does";
    if !common::long() {
        return common::not_run(TEST, "SPLATGRAPH_LONG, since the compiler is waited for a minute");
    }
    let place = Place::new();
    place.cameras(&["one"]);
    let source = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/files/hanging_driver.c");
    fs::create_dir(place.at("driver")).expect("a folder");
    let library = place.at("driver/libvulkan.so.1");
    let built =
        Command::new("cc").args(["-shared", "-fPIC", source, "-o"]).arg(&library).arg("-ldl").status();
    assert!(built.expect("a C compiler").success());
    for (after, args) in [
        (0, "render scene.ply -c cameras.json -o a.png"),
        (2, "bench scene.ply -c cameras.json --pipelines splat --json=a.json"),
    ] {
        let output = place
            .program(args)
            .env("LD_LIBRARY_PATH", place.at("driver"))
            .env("HANGING_REAL", loader())
            .env("HANGING_AFTER", after.to_string())
            .output()
            .expect("it runs");
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{args:?}: {errors}");
        assert!(errors.contains("the driver has been compiling shader `"), "{args:?}: {errors}");
        assert!(errors.contains("for more than 60 s; it may never end"), "{args:?}: {errors}");
    }
    assert!(!place.at("a.png").exists());
}
