//! Fault isolation: code memory that runs out, and panics in every thread that runs a user's work.

#![allow(clippy::unwrap_used)]

use std::panic::resume_unwind;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use isophote_capture::{Captured, FrameSource, SourceError};
use isophote_jit::{CodeMemory, CodeStep, PixelFormat, VectorWidth};
use isophote_tracker::{Buffer, Frame, Lease, Plane};
use isophote_wire::{ModelAnswer, Pace, SessionState, ShadowDocument, ShadowState};
use serde_json::{Value, json};
use tokio::sync::oneshot;

use super::Service;
use super::simulation::{WIDTH, source};
use super::tests::{checked_at_once, swap_at_once};
use crate::http::preconditions::Preconditions;
use crate::name::Name;
use crate::problem::Problem;
use crate::registry::ModelEntry;
use crate::service::compiler::Owner;
use crate::service::declared::Keeping;
use crate::service::machine::Machine;
use crate::service::workshop::Lane;
use crate::session::SlowModels;
use crate::session::inbox::Reply;
use crate::source::{FrameShape, Opened, Producer};
use crate::store::MemoryStore;

/// A panic without output.
fn panics() -> ! {
    resume_unwind(Box::new("planted"))
}

/// The fault injected into the next compilation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Trouble {
    Refused(CodeStep),
    Panic,
}

#[derive(Debug, Default)]
struct TroubledMemory(Mutex<Option<Trouble>>);

impl TroubledMemory {
    fn trouble(&self, what: Option<Trouble>) {
        *self.0.lock().unwrap() = what;
    }
}

impl CodeMemory for TroubledMemory {
    fn permit(&self, step: CodeStep) -> Result<(), String> {
        let trouble = *self.0.lock().unwrap();
        match trouble {
            Some(Trouble::Refused(at)) if at == step => Err("planted".into()),
            Some(Trouble::Panic) => panics(),
            _ => Ok(()),
        }
    }
}

/// Pixels that make the thread of that name panic.
struct Deadly {
    thread: &'static str,
    pixels: Vec<u8>,
}

impl Lease for Deadly {
    fn bytes(&self) -> &[u8] {
        if std::thread::current().name() == Some(self.thread) { panics() } else { &self.pixels }
    }
}

/// A source that panics at its first frame.
struct DeadlySource;

impl FrameSource for DeadlySource {
    fn next(&mut self) -> Result<Option<Captured>, SourceError> {
        panics()
    }
    fn description(&self) -> String {
        "a fault".into()
    }
    fn size(&self) -> Option<Vec<usize>> {
        None
    }
}

/// A service with the source `eye`, and the models `level` and `slope`.
struct Rig {
    service: Service,
    owner: Owner,
    memory: Arc<TroubledMemory>,
}

fn name(text: &str) -> Name {
    Name::parse(text).unwrap()
}

impl Rig {
    fn start() -> Rig {
        let memory = Arc::new(TroubledMemory::default());
        let mut machine = Machine::of_machine(VectorWidth::default());
        machine.memory = Some(memory.clone());
        let service = Service::of_store(Arc::new(MemoryStore::default()), Arc::new(machine)).unwrap();
        let mut rig = Rig { service, owner: Owner::new(), memory };
        for (model, intensity) in [("level", "v0"), ("slope", "v0 + 0.125 * x")] {
            let checked = rig.check(model, intensity).unwrap();
            rig.service.put_model(&mut rig.owner, &name(model), &Preconditions::default(), checked).unwrap();
        }
        rig.service.put_source(&mut rig.owner, &name("eye"), source(WIDTH), None, Keeping::Declared).unwrap();
        rig
    }

    fn check(&self, model: &str, intensity: &str) -> Result<(ModelEntry, ModelAnswer), Problem> {
        let document = json!({"name": model, "coordinates": ["x", "y"], "channels": ["phi"],
                              "parameters": {"v0": {"start": 1}}, "model": {"intensity": intensity}});
        checked_at_once(&self.service, model, &document)
    }

    fn put_session(&mut self, session: &str, model: &str) -> Result<(), Problem> {
        let document = serde_json::from_value(json!({"source": "eye", "model": model})).unwrap();
        let put = self.service.put_session(&mut self.owner, &name(session), document, None, None, Keeping::Declared);
        put.map(drop)
    }

    fn swap(&mut self, session: &str, model: &str) -> Result<(), Problem> {
        swap_at_once(&self.service, &mut self.owner, session, model)
    }

    /// Pushes a frame, which all sessions receive; returns that session's estimate.
    fn push(&self, session: &str, plane: Plane) -> Value {
        let running = self.service.session(session).unwrap();
        let rows = plane.buffer.bytes().len() / WIDTH;
        let frame = Frame::new(&[WIDTH, rows], vec![plane]).unwrap();
        let (sender, answer) = oneshot::channel();
        let reply = Reply { session: running.inbox().clone(), sender };
        running.source().source.push(Captured { frame, file: None, truth: None }, reply).unwrap();
        serde_json::to_value(&*answer.blocking_recv().unwrap()).unwrap()
    }

    /// Pushes a uniform frame; returns the session's model and its rounded level.
    fn fitted(&self, session: &str) -> (String, f64) {
        let plane = Plane::owned(PixelFormat::U8, vec![100; WIDTH * 6], WIDTH);
        let estimate = self.push(session, plane);
        let model = estimate["model"].as_str().unwrap().split('@').next().unwrap().to_string();
        (model, estimate["parameters"]["v0"].as_f64().unwrap().round())
    }
}

#[test]
fn sessions_keep_their_kernels_when_code_memory_runs_out() {
    for step in [CodeStep::Map, CodeStep::Protect] {
        let mut rig = Rig::start();
        rig.put_session("one", "level").unwrap();
        assert_eq!(rig.fitted("one"), ("level".into(), 100.0));
        rig.memory.trouble(Some(Trouble::Refused(step)));
        let refused = [
            ("a document", rig.check("new", "v0 + 7").map(drop)),
            ("a swap", rig.swap("one", "slope")),
            ("a session", rig.put_session("two", "slope")),
        ];
        for (what, refused) in refused {
            let problem = refused.unwrap_err();
            assert_eq!((problem.status.as_u16(), problem.code), (503, "no-code-memory"), "{what}: {problem:?}");
            assert!(problem.detail.contains("planted") && problem.diagnostics.is_empty(), "{what}: {problem:?}");
        }
        assert_eq!(rig.fitted("one"), ("level".into(), 100.0), "{step:?}");
        let view = rig.service.session_view("one").unwrap();
        assert_eq!((view.state, view.requested_model.as_str()), (SessionState::Running, "level"), "{step:?}");
        assert!(rig.service.session("two").is_err());
        rig.memory.trouble(None);
        rig.swap("one", "slope").unwrap();
        assert_eq!(rig.fitted("one").0, "slope", "{step:?}");
        rig.service.stop();
    }
}

/// Polls until `is_so`.
fn until(what: &str, is_so: impl Fn() -> bool) {
    let begin = Instant::now();
    while !is_so() {
        assert!(begin.elapsed() < Duration::from_secs(60), "{what}");
        std::thread::park_timeout(Duration::from_millis(1));
    }
}

impl Rig {
    /// Pushes a frame that makes the named thread panic; waits for the other session's estimate.
    fn push_deadly(&self, session: &str, thread: &'static str) {
        let buffer = Buffer::Leased(Arc::new(Deadly { thread, pixels: vec![100; WIDTH * 6] }));
        self.push(session, Plane { buffer, ..Plane::owned(PixelFormat::U8, Vec::new(), WIDTH) });
    }

    /// State of a session, and its reason.
    fn state(&self, session: &str) -> (SessionState, String) {
        let view = self.service.session_view(session).unwrap();
        (view.state, view.reason.unwrap_or_default())
    }

    fn put_shadow(&mut self, session: &str, model: &str) {
        let (running, entry) = (self.service.session(session).unwrap(), self.service.registry.get(model).unwrap());
        let document: ShadowDocument = serde_json::from_value(json!({"model": model})).unwrap();
        // The model is measured on the next frame.
        let prepared = std::thread::scope(|scope| {
            let prepare = || running.prepare_shadow(entry, &document, &self.service.workshop.at_once());
            let preparing = scope.spawn(prepare);
            while !preparing.is_finished() {
                self.fitted(session);
            }
            preparing.join().unwrap().unwrap()
        });
        self.service.put_shadow(&mut self.owner, session, &running, prepared).unwrap();
    }

    /// Prepares a swap on a thread of the workshop, as the route does.
    fn prepare_swap_beside(&self, session: &str, model: &str) -> Result<(), Problem> {
        let (running, entry) = (self.service.session(session).unwrap(), self.service.registry.get(model).unwrap());
        let prepare = self.service.workshop.prepare(Lane::Sessions, move |workers| {
            running.prepare_swap(&entry, SlowModels::Allowed, workers).map(drop)
        });
        tokio::runtime::Builder::new_current_thread().build().unwrap().block_on(prepare)
    }
}

/// Panics a hundred times each in the threads that fit, shadow, compile and produce frames, beside a session that goes on. For
/// panics in routes see `guard.rs`, in the owner's changes `compiler.rs`.
#[test]
fn panics_are_isolated() {
    let mut rig = Rig::start();
    rig.put_session("witness", "level").unwrap();
    let well = ("level".to_string(), 100.0);
    for round in 0..100 {
        rig.put_session("one", "level").unwrap();
        assert_eq!(rig.fitted("one"), well, "{round}");
        rig.push_deadly("witness", "fit one");
        until("the session fails", || rig.state("one").0 == SessionState::Failed);
        assert_eq!(rig.state("one").1, "bug: the fit thread panicked");
        assert_eq!(rig.fitted("witness"), well, "{round}");

        rig.put_shadow("witness", "level");
        rig.push_deadly("witness", "shadow witness");
        let shadow = || rig.service.session("witness").unwrap().shadow().unwrap().view();
        until("the shadow fails", || shadow().state == ShadowState::Failed);
        assert!(shadow().reason.unwrap().starts_with("bug: "), "{round}");
        assert_eq!(rig.fitted("witness"), well, "{round}");

        rig.memory.trouble(Some(Trouble::Panic));
        let problem = rig.prepare_swap_beside("witness", "slope").unwrap_err();
        assert_eq!((problem.status.as_u16(), problem.code), (500, "bug"), "{round}");
        rig.memory.trouble(None);
        assert_eq!(rig.fitted("witness"), well, "{round}");

        let document = json!({"kind": "recording", "path": "a fault", "rate_hz": 0, "pace": "fit"});
        let producer = Producer::Frames(Box::new(DeadlySource));
        let opened = Opened { producer, shape: FrameShape::default(), pace: Pace::Fit, rate_hz: 0.0, held: None };
        let document = serde_json::from_value(document).unwrap();
        rig.service.put_source(&mut rig.owner, &name("dead"), document, Some(opened), Keeping::Declared).unwrap();
        let session = serde_json::from_value(json!({"source": "dead", "model": "level"})).unwrap();
        rig.service.put_session(&mut rig.owner, &name("blind"), session, None, None, Keeping::Declared).unwrap();
        until("the session loses its source", || rig.state("blind").0 == SessionState::LostSource);
        assert_eq!(rig.state("blind").1, "bug: the source's thread panicked");
        rig.service.remove_session(&mut rig.owner, &name("blind")).unwrap();
        rig.service.remove_source(&mut rig.owner, &name("dead")).unwrap();
        assert_eq!(rig.fitted("witness"), well, "{round}");
    }
    assert_eq!(rig.state("witness").0, SessionState::Running);
    rig.prepare_swap_beside("witness", "slope").unwrap();
    rig.service.stop();
}
