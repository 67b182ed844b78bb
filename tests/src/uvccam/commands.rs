//! Controls the camera by text commands, for tests that run it as a separate program: one line each way.
//!
//! `plug [SERIAL]`, `unplug`, `stall MS`, `error`, `short`, `scene ramp`, `scene spot X Y A B AMPLITUDE BACKGROUND`,
//! `scene film PATH WIDTH HEIGHT`, `noise READ_DN DN_PER_E SEED`, `number on|off`, `state`, `quit`. The answer is
//! `ok`, the requested value, or begins with `error: `.

use std::fs;
use std::io::{self, BufRead, BufReader, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::str::SplitWhitespace;
use std::time::Duration;

use super::{Camera, Fault, Noise, Scene};
use crate::rig::until;

/// Default serial number.
const SERIAL: &str = "0001";
/// Timeout for the program to start.
const START_S_MAX: u64 = 20;

/// Executes the lines received over the socket `path`, which is created here, until `quit`.
pub fn run_commands(camera: &mut Camera, path: &Path) -> io::Result<()> {
    let listener = UnixListener::bind(path)?;
    for connection in listener.incoming() {
        let connection = connection?;
        let mut answers = connection.try_clone()?;
        for line in BufReader::new(connection).lines() {
            let line = line?;
            let answer = one(camera, &line).unwrap_or_else(|reason| format!("error: {line}: {reason}"));
            writeln!(answers, "{answer}")?;
            if line.trim() == "quit" {
                return fs::remove_file(path);
            }
        }
    }
    Ok(())
}

/// Sends a line to the socket of a camera program and returns its answer; waits for the program to start.
///
/// # Errors
/// The program does not start in time, or answers with an error.
pub fn send_command(path: &Path, line: &str) -> io::Result<String> {
    let connect = || UnixStream::connect(path).ok();
    let mut socket = until("camera program", Duration::from_secs(START_S_MAX), connect)?;
    writeln!(socket, "{line}")?;
    let mut answer = String::new();
    BufReader::new(socket).read_line(&mut answer)?;
    match answer.trim() {
        "" => Err(io::Error::other(format!("no answer to {line}"))),
        error if error.starts_with("error: ") => Err(io::Error::other(error.to_string())),
        answer => Ok(answer.to_string()),
    }
}

fn one(camera: &mut Camera, line: &str) -> Result<String, String> {
    let mut words = line.split_whitespace();
    match words.next().unwrap_or_default() {
        "plug" => camera.plug(words.next().unwrap_or(SERIAL)).map_err(|error| error.to_string())?,
        "unplug" => camera.unplug(),
        "stall" => camera.stall(Duration::from_millis(number(&mut words)?)),
        "error" => camera.spoil(Fault::Error),
        "short" => camera.spoil(Fault::Short),
        "scene" => camera.show(scene(&mut words)?),
        "noise" => {
            let (read_dn, dn_per_e) = (number(&mut words)?, number(&mut words)?);
            camera.scatter(Noise { read_dn, dn_per_e, seed: number(&mut words)? });
        }
        "number" => camera.number(words.next() == Some("on")),
        "state" => return Ok(camera.controls().map_or("unplugged".into(), |state| format!("{state:?}"))),
        "quit" => {}
        _ => return Err("not a command".into()),
    }
    Ok("ok".into())
}

fn scene(words: &mut SplitWhitespace) -> Result<Scene, String> {
    match words.next().unwrap_or_default() {
        "ramp" => Ok(Scene::Ramp),
        "spot" => {
            let mut next = || number(words);
            let (centre, half_axes) = ([next()?, next()?], [next()?, next()?]);
            Ok(Scene::Spot { centre, half_axes, amplitude: next()?, background: next()? })
        }
        "film" => {
            let bytes = fs::read(words.next().unwrap_or_default()).map_err(|error| error.to_string())?;
            Scene::film(&bytes, [number(words)?, number(words)?])
        }
        _ => Err("a scene is ramp, spot or film".into()),
    }
}

fn number<T: std::str::FromStr>(words: &mut SplitWhitespace) -> Result<T, String> {
    words.next().and_then(|word| word.parse().ok()).ok_or_else(|| "a number is missing".into())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn commands_are_executed_or_rejected_with_a_reason() {
        let mut camera = Camera::new(Scene::Ramp);
        let mut say = |line: &str| one(&mut camera, line);
        assert_eq!(say("scene spot 320 240 30 20.5 600 20").unwrap(), "ok");
        assert_eq!(say("noise 1.5 0.05 7").unwrap(), "ok");
        assert_eq!(say("state").unwrap(), "unplugged");
        for line in ["scene spot 320 240", "scene moon", "noise 1", "stall soon", "scene film nowhere 2 2", "jump"] {
            assert!(say(line).is_err(), "{line}");
        }
        let spot = Scene::Spot { centre: [320.0, 240.0], half_axes: [30.0, 20.5], amplitude: 600.0, background: 20.0 };
        assert_eq!((&*camera.scene, camera.noise.seed), (&spot, 7));
    }
}
