//! A software USB camera as a separate program: `uvccam SOCKET [SERIAL]`. It plugs itself in where the kernel has
//! vhci-hcd and uvcvideo, and obeys commands over SOCKET, see `isophote_tests::uvccam::commands`.

use std::path::Path;
use std::process::ExitCode;

use isophote_tests::uvccam::{Camera, Scene, commands};

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (socket, serial) = match arguments.as_slice() {
        [socket] => (socket, "0001"),
        [socket, serial] => (socket, serial.as_str()),
        _ => {
            eprintln!("uvccam SOCKET [SERIAL]");
            return ExitCode::from(2);
        }
    };
    let mut camera = Camera::new(Scene::Ramp);
    match camera.plug(serial).and_then(|()| commands::run_commands(&mut camera, Path::new(socket))) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("uvccam: {error}");
            ExitCode::FAILURE
        }
    }
}
