//! The software USB camera, seen through the kernel's driver and v4l2-ctl.

use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use isophote_tests::rig::{Rig, USB, in_rig, until};
use isophote_tests::uvccam::{Camera, Noise, Scene, commands, node};

use crate::{ctl, stream};

const SIZE: [usize; 2] = [640, 480];
const SPOT: Scene = Scene::Spot { centre: [300.0, 200.0], half_axes: [40.0, 30.0], amplitude: 600.0, background: 20.0 };

/// Pictures with their numbers.
fn pictures(bytes: &[u8], [width, height]: [usize; 2]) -> Vec<(u32, &[u8])> {
    assert_eq!(bytes.len() % (width * height), 0);
    let number = |picture: &[u8]| u32::from_le_bytes(picture[..4].try_into().unwrap());
    bytes.chunks_exact(width * height).map(|picture| (number(picture), picture)).collect()
}

#[test]
#[ignore = "long proof"]
fn exposure_gain_and_brightness_act_on_the_picture() {
    in_rig(Rig { modules: USB, ..Rig::default() }, || {
        let mut camera = Camera::new(SPOT);
        camera.number(true);
        camera.plug("rig-7").unwrap();
        let device = node("rig-7").unwrap();
        let all = ctl(&device, &["--all", "--list-ctrls"]).stdout;
        for name in ["uvcvideo", "auto_exposure", "exposure_time_absolute", "gain", "brightness", "rig-7"] {
            assert!(all.contains(name), "no {name} in\n{all}");
        }
        // Automatic exposure: the light is unchanged and the spot's middle saturated.
        let bytes = stream(&device, "GREY", SIZE, 3);
        let at = |picture: &[u8], x: usize, y: usize| picture[y * SIZE[0] + x];
        let seen = pictures(&bytes, SIZE);
        assert!(seen.windows(2).all(|pair| pair[0].0 < pair[1].0), "numbers grow");
        let last = seen[2].1;
        assert_eq!((at(last, 300, 200), at(last, 10, 10)), (255, 20));
        // Manual: a fifth of the time, half the gain, 5 DN more: 62 + 5 in the middle, 2 + 5 around.
        let set =
            ctl(&device, &["--set-ctrl=auto_exposure=1", "--set-ctrl=exposure_time_absolute=20,gain=32,brightness=5"]);
        assert_eq!(set.status, Some(0), "{}", set.stderr);
        let (controls, _) = camera.controls().unwrap();
        assert_eq!((controls.light(), controls.brightness), (0.1, 5));
        let bytes = stream(&device, "GREY", SIZE, 2);
        let dim = pictures(&bytes, SIZE)[1].1;
        assert_eq!((at(dim, 300, 200), at(dim, 10, 10)), (67, 7));
        // The small size, with chroma; noise scatters around the mean.
        camera.scatter(Noise { read_dn: 2.0, dn_per_e: 0.0, seed: 3 });
        let small = stream(&device, "YUYV", [320, 240], 2);
        assert_eq!(small.len(), 2 * 2 * 320 * 240);
        let luma = small[2 * 320 * 240..].chunks_exact(2).map(|pair| f64::from(pair[0]));
        let dark: Vec<f64> = luma.skip(320).take(320 * 100).collect();
        let mean = dark.iter().sum::<f64>() / dark.len() as f64;
        let spread = dark.iter().map(|pixel| (pixel - mean).powi(2)).sum::<f64>() / dark.len() as f64;
        assert!((mean - 7.0).abs() < 0.1 && (spread.sqrt() - 2.02).abs() < 0.1, "{mean} {spread}");
    });
}

/// The program's commands: damaged pictures are lost, a stall lasts, unplugging removes the node, and plugging in
/// again creates one.
#[test]
#[ignore = "long proof"]
fn commands_control_the_camera() {
    in_rig(Rig { modules: USB, ..Rig::default() }, || {
        let socket = Path::new("/run/uvccam");
        let mut program = Command::new(env!("CARGO_BIN_EXE_uvccam")).arg(socket).arg("rig-8").spawn().unwrap();
        let tell = |line: &str| commands::send_command(socket, line).unwrap();
        let device = node("rig-8").unwrap();
        assert_eq!(tell("number on"), "ok");
        let mut next = 0;
        // The numbers of the first picture that arrives and of the first that was taken.
        let mut first = || {
            let bytes = stream(&device, "GREY", [320, 240], 2);
            let numbers: Vec<u32> = pictures(&bytes, [320, 240]).iter().map(|(number, _)| *number).collect();
            let taken = next;
            // Pictures are taken until the driver has stopped.
            let state = tell("state");
            next = state.trim_end_matches(')').rsplit(' ').next().unwrap().parse().unwrap();
            (numbers[0], taken)
        };
        let (arrived, taken) = first();
        assert_eq!(arrived, taken);
        for fault in ["error", "short"] {
            assert_eq!(tell(fault), "ok");
            let (arrived, taken) = first();
            assert_eq!(arrived, taken + 1, "the picture with the fault `{fault}` is lost, and no other");
        }
        tell("stall 1500");
        let before = Instant::now();
        first();
        assert!(before.elapsed() > Duration::from_millis(1500));
        assert!(tell("state").contains("exposure: 100"));
        assert!(commands::send_command(socket, "jump").unwrap_err().to_string().contains("jump: not a command"));
        tell("unplug");
        until("end of the node", Duration::from_secs(10), || (!device.exists()).then_some(())).unwrap();
        tell("plug rig-9");
        assert!(node("rig-9").unwrap().exists());
        tell("quit");
        assert!(program.wait().unwrap().success());
    });
}
