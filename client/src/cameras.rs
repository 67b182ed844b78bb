//! `isophote cameras`, `isophote camera set`: the cameras of the service's machine; of this machine where `--server`
//! is the default and no service runs.

use std::io::Write;

use isophote_capture::camera::{self, CameraError, ControlValue, ControlValues};
use isophote_wire::{CameraInfo, ControlsAnswer, Items};

use crate::arguments::ValueArgs;
use crate::failure::Failure;
use crate::http::{Refusal, RemoteService, ServiceArgs, segment};
use crate::output;

/// List the cameras with their formats and controls
#[derive(Clone, Debug, clap::Args)]
pub struct ListCamerasArgs {
    #[command(flatten)]
    service: ServiceArgs,
}

/// Set controls of a camera, also while it streams, and print the values that the driver applied
#[derive(Clone, Debug, clap::Args)]
pub struct SetArgs {
    /// Path such as /dev/video0, or identity as listed by `isophote cameras`
    pub device: String,
    /// Controls: numbers, true or false, or menu items; exposure, gain and white_balance are common names for all cameras
    #[arg(required = true, value_name = "k=v")]
    pub controls: Vec<ValueArgs>,
    #[command(flatten)]
    service: ServiceArgs,
}

/// Lists all cameras.
pub fn list(args: &ListCamerasArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let cameras = match RemoteService::new(&args.service)?.try_get::<Items<CameraInfo>>("/v1/cameras") {
        Ok(cameras) => cameras,
        Err(refusal) => or_local(&args.service, refusal, || Ok(Items { items: camera::cameras(), next: None }))?,
    };
    if args.service.json {
        return output::json(out, &cameras);
    }
    if cameras.items.is_empty() {
        return writeln!(out, "no camera is plugged in, or none may be opened (is the user in the group `video`?)")
            .map_err(Failure::output);
    }
    for (number, camera) in cameras.items.iter().enumerate() {
        if number > 0 {
            writeln!(out).map_err(Failure::output)?;
        }
        print(camera, out)?;
    }
    Ok(())
}

/// Falls back to this machine if the default service is unreachable.
fn or_local<T>(args: &ServiceArgs, refusal: Refusal, here: impl FnOnce() -> Result<T, Failure>) -> Result<T, Failure> {
    match refusal {
        Refusal::Failed(Failure::Unreachable(_)) if args.is_default() => {
            eprintln!("no service runs at {}: these are the cameras of this machine", args.server);
            here()
        }
        refusal => Err(refusal.into()),
    }
}

fn print(camera: &CameraInfo, out: &mut dyn Write) -> Result<(), Failure> {
    let serial = camera.serial.as_ref().map(|serial| format!(", serial number {serial}")).unwrap_or_default();
    writeln!(
        out,
        "{}  {}\n  {} ({}, {}{serial})",
        camera.device, camera.identity, camera.name, camera.driver, camera.bus
    )
    .map_err(Failure::output)?;
    let read = camera.formats.iter().filter(|format| format.is_read);
    let formats: Vec<Vec<String>> = read
        .flat_map(|format| {
            format.sizes.iter().map(|size| {
                let from = size.from.map(|[width, height]| format!("{width}x{height} to ")).unwrap_or_default();
                let rates: Vec<String> = size.rates_hz.iter().map(|rate| format!("{rate}")).collect();
                vec![format.format.clone(), format!("{from}{}x{}", size.width, size.height), rates.join(" ")]
            })
        })
        .collect();
    output::table(out, &["FORMAT", "SIZE", "HZ"], &formats)?;
    let others: Vec<&str> = camera.formats.iter().filter(|f| !f.is_read).map(|f| f.format.as_str()).collect();
    if !others.is_empty() {
        writeln!(out, "formats that are not read here: {}", others.join(" ")).map_err(Failure::output)?;
    }
    let row = |control: &isophote_wire::ControlInfo| {
        let meaning = control.value.and_then(|value| control.items.get(&value)).cloned();
        vec![
            control.name.clone(),
            control.value.map_or_else(|| "-".into(), |value| value.to_string()),
            format!("{} to {}", control.minimum, control.maximum),
            control.step.to_string(),
            control.default.to_string(),
            [meaning, control.is_inactive.then(|| "(inactive)".to_string())]
                .into_iter()
                .flatten()
                .collect::<Vec<_>>()
                .join(" "),
        ]
    };
    let controls: Vec<Vec<String>> = camera.controls.iter().map(row).collect();
    output::table(out, &["CONTROL", "VALUE", "RANGE", "STEP", "DEFAULT", ""], &controls)
}

/// Sets controls of one camera.
pub fn set(args: &SetArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let values: ControlValues = ValueArgs::merged(&args.controls).map_err(Failure::Usage)?;
    let path = format!("/v1/cameras/{}/controls", segment(&args.device));
    let answer: ControlsAnswer = match RemoteService::new(&args.service)?.try_put(&path, &values) {
        Ok(answer) => answer,
        Err(refusal) => or_local(&args.service, refusal, || {
            let controls = camera::set_controls(&args.device, &values, &|| true);
            Ok(ControlsAnswer { controls: controls.map_err(failure)? })
        })?,
    };
    if args.service.json {
        return output::json(out, &answer);
    }
    for (name, taken) in &answer.controls {
        let asked = values.get(name).filter(|asked| *asked != taken && !matches!(asked, ControlValue::Word(_)));
        let asked = asked.map(|asked| format!(" (asked for {})", text(asked))).unwrap_or_default();
        writeln!(out, "{name} {}{asked}", text(taken)).map_err(Failure::output)?;
    }
    Ok(())
}

/// Maps the error to the status that the service would answer with.
fn failure(error: CameraError) -> Failure {
    match error {
        CameraError::Missing { .. } | CameraError::NotACamera { .. } => Failure::NotFound(error.to_string()),
        CameraError::Control { .. } => Failure::Refused(error.to_string()),
        other => Failure::Other(other.to_string()),
    }
}

fn text(value: &ControlValue) -> String {
    match value {
        ControlValue::Switch(on) => on.to_string(),
        ControlValue::Number(number) => number.to_string(),
        ControlValue::Word(word) => word.clone(),
    }
}
