//! Tests of the rig's machine and its cameras, which other camera tests rely on.
#![allow(clippy::unwrap_used)]

mod loopback;
mod machine;
mod uvccam;
mod vivid;

use std::path::Path;
use std::process::Command;
use std::time::Duration;

use isophote_tests::{Finished, finish};

/// Timeout of one command in the rig.
const COMMAND: Duration = Duration::from_secs(20);

/// Output of v4l2-ctl on a device, whatever its status.
fn ctl(device: &Path, arguments: &[&str]) -> Finished {
    let mut command = Command::new("v4l2-ctl");
    command.arg("--device").arg(device).args(arguments);
    finish(&mut command, COMMAND).unwrap()
}

/// Sets a format and returns the following pictures, concatenated.
fn stream(device: &Path, fourcc: &str, [width, height]: [usize; 2], pictures: usize) -> Vec<u8> {
    let file = std::env::temp_dir().join(format!("stream-{}", fourcc.trim()));
    let format = format!("--set-fmt-video=width={width},height={height},pixelformat={fourcc}");
    let (count, to) = (format!("--stream-count={pictures}"), format!("--stream-to={}", file.display()));
    let finished = ctl(device, &[&format, "--stream-mmap=4", &count, &to]);
    assert_eq!(finished.status, Some(0), "{fourcc}: {}{}", finished.stdout, finished.stderr);
    std::fs::read(file).unwrap()
}
