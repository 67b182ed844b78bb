//! Controls a source: a lease on its exposure and camera controls, and the values set with it.

use std::time::{Duration, Instant};

use axum::http::StatusCode;
use isophote_capture::camera::{self, CameraStatus};
use isophote_wire::{CameraInfo, ControlCommand, ControlDocument, ControlView, SourceDocument};

use super::{ControlLease, LeaseId, Source, camera_problem};
use crate::http::preconditions::{EntityTag, Preconditions};
use crate::limits::LIMITS;
use crate::problem::Problem;

/// Names of a camera: its path, with links resolved, and its identity.
pub struct CameraNames([String; 2]);

impl CameraNames {
    /// The names of a connected camera.
    pub fn of(camera: &CameraInfo) -> CameraNames {
        CameraNames([plain(&camera.device), camera.identity.clone()])
    }

    fn has(&self, name: &str) -> bool {
        self.0.contains(&plain(name))
    }
}

/// A path without links, dots and doubled slashes; anything else unchanged.
fn plain(name: &str) -> String {
    let path = std::path::Path::new(name);
    let found = path.is_absolute().then(|| path.canonicalize().ok()).flatten();
    found.map_or_else(|| name.to_string(), |path| path.display().to_string())
}

impl Source {
    /// The lease on its controls.
    pub fn lease(&self) -> &ControlLease {
        &self.lease
    }

    /// Settings and losses of a camera.
    pub fn camera(&self) -> Option<CameraStatus> {
        self.shared.lock().camera.clone()
    }

    /// The holder of the lease and the last command, with the tag of the lease, if there is one.
    ///
    /// # Errors
    /// 409 if the source has no controls.
    pub fn control(&self) -> Result<(Option<EntityTag>, ControlView), Problem> {
        self.check_knobs()?;
        Ok(self.lease.view(Instant::now()))
    }

    /// Takes or renews the lease and sets the document's values; returns whether the lease is new. May block in a camera's
    /// driver.
    ///
    /// # Errors
    /// 409 if another holder has the lease, and if the source has no such controls; 422 if a number is out of range. Then
    /// nothing was set, except that camera controls before the wrong one may have been.
    pub fn take_control(
        &self,
        document: &ControlDocument,
        preconditions: &Preconditions,
    ) -> Result<(bool, Option<EntityTag>, ControlView), Problem> {
        self.check_knobs()?;
        self.check(document)?;
        let id = match &document.lease {
            Some(id) => LeaseId::Client(id.clone()),
            None => LeaseId::Client(random_id()?),
        };
        if document.lease.is_some() && !self.lease.has(&id, Instant::now()) {
            let whose = self.lease.holder(Instant::now()).unwrap_or_else(|| "it has run out; take a new one".into());
            return Err(Problem::conflict("in-use", format!("this lease is not in force: {whose}")));
        }
        let timeout = Duration::from_secs_f64(document.timeout_s);
        let is_new = self.lease.take_if(preconditions, (&document.owner, &id), timeout, Instant::now())?;
        let set = self.obey(&id, document);
        if is_new && set.is_err() {
            self.lease.release(&id, Instant::now(), || ());
        }
        set?;
        let LeaseId::Client(lease) = id else { return Err(Problem::bug("a client has a client's lease")) };
        let (tag, view) = self.lease.view(Instant::now());
        Ok((is_new, tag, ControlView { lease: Some(lease), ..view }))
    }

    /// Releases the lease. Values that were set stay.
    ///
    /// # Errors
    /// 409 if another client has it, 404 if there is none, 412.
    pub fn leave_control(&self, lease: Option<&str>, preconditions: &Preconditions) -> Result<(), Problem> {
        self.check_knobs()?;
        let id = LeaseId::Client(lease.unwrap_or_default().to_string());
        if self.lease.release_if(preconditions, &id, Instant::now())? {
            return Ok(());
        }
        match self.lease.holder(Instant::now()) {
            Some(whose) => {
                let detail = format!("{whose}; its holder ends it with ?lease=, the id that taking it answered");
                Err(Problem::conflict("in-use", detail))
            }
            None => {
                Err(Problem::new(StatusCode::NOT_FOUND, "unknown-name", "nobody has a lease on this source's knobs"))
            }
        }
    }

    /// 409 if this is a source of that camera and its lease is taken.
    pub fn refuse_others(&self, camera: &CameraNames) -> Result<(), Problem> {
        let SourceDocument::Camera(document) = &self.document else { return Ok(()) };
        let status = self.camera();
        let names = status.iter().flat_map(|status| [&status.device, &status.identity]).chain([&document.device]);
        let is_it = names.into_iter().any(|name| camera.has(name));
        let whose = self.lease.holder(Instant::now()).filter(|_| is_it);
        whose.map_or(Ok(()), |whose| Err(ControlLease::refused(whose)))
    }

    fn check_knobs(&self) -> Result<(), Problem> {
        if self.exposure.is_some() || matches!(self.document, SourceDocument::Camera(_)) {
            return Ok(());
        }
        let kind = self.document.kind();
        let detail = format!(
            "a {kind} source has nothing to control: cameras have exposure and controls, synthetic sources an exposure"
        );
        Err(Problem::conflict("not-applicable", detail))
    }

    fn check(&self, document: &ControlDocument) -> Result<(), Problem> {
        let out_of_range = |key: &str, message: String| Err(Problem::wrong_key("out-of-range", key, message));
        let ControlDocument { owner, timeout_s, exposure, controls, .. } = document;
        if owner.is_empty() || owner.chars().count() > LIMITS.owner_characters || owner.chars().any(char::is_control) {
            let most = LIMITS.owner_characters;
            return out_of_range(
                "owner",
                format!("an owner is 1 to {most} characters, none of them a control character"),
            );
        }
        let (least, most) = LIMITS.lease_time_s;
        if !(least..=most).contains(timeout_s) {
            return out_of_range("timeout_s", format!("timeout_s is {timeout_s}; it may be {least} to {most} s"));
        }
        if let Some(factor) = exposure {
            let Some(knob) = &self.exposure else {
                return Err(Problem::conflict("not-applicable", "the source has no exposure that could be set"));
            };
            let (least, most) = knob.range().map_or(LIMITS.exposure, |[least, most]| (least, most));
            if !(least..=most).contains(factor) {
                let message = format!("exposure is {factor}; it may be {least} to {most} times that of the beginning");
                return out_of_range("exposure", message);
            }
        }
        if !controls.is_empty() && !matches!(self.document, SourceDocument::Camera(_)) {
            let message = "only cameras have controls; the gain of a synthetic source is a part of its scene";
            return Err(Problem::conflict("not-applicable", message));
        }
        Ok(())
    }

    /// Sets the document's exposure and controls.
    fn obey(&self, id: &LeaseId, document: &ControlDocument) -> Result<(), Problem> {
        let ControlDocument { exposure, controls, .. } = document;
        if exposure.is_none() && controls.is_empty() {
            return Ok(());
        }
        let mut taken = controls.clone();
        if let (SourceDocument::Camera(camera), false) = (&self.document, controls.is_empty()) {
            let Some(spare) = &self.spare else { return Err(Problem::bug("a camera without a spare")) };
            let (lease, id, device, wanted) = (self.lease.clone(), id.clone(), camera.device.clone(), controls.clone());
            let is_theirs = move || lease.has(&id, Instant::now());
            let set = move || camera::set_controls(&device, &wanted, &is_theirs);
            let set = spare.drivers().ask(&camera.device, LIMITS.camera_open_time, set)?;
            taken = set.map_err(|error| match &error {
                isophote_capture::CameraError::Control { name, .. } => {
                    Problem::wrong_key("wrong-value", &format!("controls.{name}"), error.to_string())
                }
                _ => camera_problem(&error, ""),
            })?;
        }
        let command = ControlCommand { exposure: *exposure, controls: taken };
        let is_theirs = self.lease.turn(id, command, Instant::now(), || {
            if let (Some(knob), Some(factor)) = (&self.exposure, exposure) {
                knob.set(*factor);
            }
            self.shown_from()
        });
        let late = || Problem::conflict("in-use", "the lease ran out while the camera took its time; take a new one");
        if is_theirs { Ok(()) } else { Err(late()) }
    }

    /// The first frame that shows a value set now.
    pub fn shown_from(&self) -> u64 {
        let next = match &self.scene {
            Some(scene) => scene.next_frame(),
            None => self.shared.lock().newest.map_or(0, |newest| newest + 1),
        };
        let latency = match &self.document {
            SourceDocument::Synthetic(synthetic) => synthetic.exposure_latency,
            SourceDocument::Camera(camera) => camera.exposure_latency,
            SourceDocument::Recording(_) | SourceDocument::Pushed(_) => 0,
        };
        next + u64::from(latency)
    }
}

/// 128 random bits in hex.
fn random_id() -> Result<String, Problem> {
    let mut bits = [0u8; 16];
    getrandom::fill(&mut bits).map_err(|error| Problem::bug(format!("no random bits for a lease: {error}")))?;
    Ok(bits.iter().map(|byte| format!("{byte:02x}")).collect())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn camera_is_recognized_by_any_path() {
        let folder = std::env::temp_dir().join(format!("isophote-cameras-{}", std::process::id()));
        std::fs::create_dir_all(folder.join("by-id")).unwrap();
        let device = folder.join("video0");
        std::fs::write(&device, "").unwrap();
        std::os::unix::fs::symlink("../video0", folder.join("by-id/usb-one")).unwrap();
        let names = CameraNames([plain(device.to_str().unwrap()), "one-0001".to_string()]);
        for (name, is_it) in [
            ("video0", true),
            ("./video0", true),
            ("/video0", true),
            ("by-id/../video0", true),
            ("by-id/usb-one", true),
            ("video1", false),
            ("by-id", false),
        ] {
            assert_eq!(names.has(&format!("{}/{name}", folder.display())), is_it, "{name}");
        }
        assert!(names.has("one-0001") && !names.has("one-0002") && !names.has("video0"));
        std::fs::remove_dir_all(folder).unwrap();
    }
}
