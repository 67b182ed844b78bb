//! What a source shows and how it goes on, asked and set from outside: [`SceneInForce`] and [`Playback`] do it, for those that
//! have them.

use isophote_wire::{PlaybackDocument, PlaybackView, SceneDocument, SceneView, SourceDocument, SourceState};

use super::playback::Playback;
use super::scene::SceneInForce;
use super::{Source, SourceNow};
use crate::preconditions::{EntityTag, Preconditions};
use crate::problem::Problem;

impl Source {
    /// Whether it stands still, how fast it goes, and where it is, with the tag of what clients change of that.
    ///
    /// # Errors
    /// 409 of a camera, and where clients push the frames.
    pub fn playback(&self) -> Result<(EntityTag, PlaybackView), Problem> {
        let state = self.shared.lock();
        let playback = self.playing(&state)?;
        Ok((playback.tag.clone(), playback.view()))
    }

    /// Pauses, seeks or goes on; from now on.
    ///
    /// # Errors
    /// 409 where that does not apply, 422 where a number is out of its range. Nothing has changed then.
    pub fn set_playback(
        &self,
        document: &PlaybackDocument,
        preconditions: &Preconditions,
    ) -> Result<(EntityTag, PlaybackView), Problem> {
        let mut state = self.shared.lock();
        let tag = self.playing(&state)?.tag.clone();
        preconditions.check("the playback", &[tag])?;
        refuse_when_over(&state)?;
        let changed = match &mut state.playback {
            Some(playback) => playback.change(document).map(|()| (playback.tag.clone(), playback.view()))?,
            None => return Err(Problem::bug("there was a playback")),
        };
        drop(state);
        self.shared.changed.notify_all();
        Ok(changed)
    }

    fn playing<'a>(&self, state: &'a SourceNow) -> Result<&'a Playback, Problem> {
        let kind = self.document.kind();
        let absent = || {
            let detail = format!("a {kind} source has no playback: its frames come when they come");
            Problem::conflict("not-applicable", detail)
        };
        state.playback.as_ref().ok_or_else(absent)
    }

    /// So many times its rate.
    pub fn speed(&self) -> f64 {
        self.shared.lock().playback.as_ref().map_or(1.0, |playback| playback.speed)
    }

    /// Somebody has paused it.
    pub fn is_still(&self) -> bool {
        self.shared.lock().playback.as_ref().is_some_and(|playback| playback.is_paused)
    }

    /// Since when frames should have come, ns: since somebody let it go on, if anybody did. `None` where a pause between frames
    /// is no fault: clients push them, or it stands still.
    pub fn steady_since_ns(&self) -> Option<u64> {
        if matches!(self.document, SourceDocument::Pushed(_)) {
            return None;
        }
        match &self.shared.lock().playback {
            Some(playback) => (!playback.is_paused).then_some(playback.changed_ns),
            None => Some(0),
        }
    }

    /// The scene, with its tag.
    ///
    /// # Errors
    /// 409 of a source that is not synthetic.
    pub fn scene(&self) -> Result<(EntityTag, SceneView), Problem> {
        Ok(self.staged()?.view())
    }

    /// Shows something else from the next frame on that is rendered; what the document does not name is as it was.
    ///
    /// # Errors
    /// 409 of a source that is not synthetic, 422 where the document is wrong. The scene is as it was then.
    pub fn set_scene(
        &self,
        scene: SceneDocument,
        preconditions: &Preconditions,
    ) -> Result<(EntityTag, SceneView), Problem> {
        let staged = self.staged()?;
        refuse_when_over(&self.shared.lock())?;
        staged.change(scene, preconditions)
    }

    /// No two starts of sources have the same.
    pub fn id(&self) -> &EntityTag {
        &self.id
    }

    /// As put, with what it shows now, and whether it begins again.
    pub fn document_now(&self) -> SourceDocument {
        let mut document = self.scene.as_ref().map_or_else(|| self.document.clone(), SceneInForce::document);
        let repeat = self.playback().ok().and_then(|(_, view)| view.repeat);
        if let (SourceDocument::Recording(recording), Some(repeat)) = (&mut document, repeat) {
            recording.repeat = repeat;
        }
        document
    }

    fn staged(&self) -> Result<&SceneInForce, Problem> {
        let kind = self.document.kind();
        let absent = || {
            let detail =
                format!("a {kind} source has no scene that could be set: only synthetic ones make their frames");
            Problem::conflict("not-applicable", detail)
        };
        self.scene.as_ref().ok_or_else(absent)
    }
}

/// 409 where no more frames come.
fn refuse_when_over(state: &SourceNow) -> Result<(), Problem> {
    let (SourceState::Ended | SourceState::Failed) = state.state else { return Ok(()) };
    let reason = state.reason.as_deref().unwrap_or("it has ended");
    let detail = format!("{reason}; delete its sessions and put the source again to play it anew");
    Err(Problem::conflict("not-applicable", detail))
}
