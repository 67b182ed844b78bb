//! What runs goes on whatever befalls something else: no memory for code.

#![allow(clippy::unwrap_used)]

use std::sync::{Arc, Mutex};

use isophote_capture::Captured;
use isophote_jit::{CodeMemory, CodeStep, KernelCache, VectorWidth};
use isophote_tracker::{Frame, Plane};
use isophote_wire::{ModelAnswer, SessionState};
use serde_json::{Value, json};
use tokio::sync::oneshot;

use super::Service;
use super::simulation::{WIDTH, source};
use crate::commons::Commons;
use crate::compiler::Owner;
use crate::declared::Keeping;
use crate::name::Name;
use crate::problem::Problem;
use crate::registry::{Expected, Media, ModelEntry};
use crate::session::SlowModels;
use crate::session::inbox::Reply;
use crate::store::MemoryStore;

/// What befalls the next kernel at a step.
#[derive(Debug, Default)]
struct TroubledMemory(Mutex<Option<CodeStep>>);

impl TroubledMemory {
    fn trouble(&self, at: Option<CodeStep>) {
        *self.0.lock().unwrap() = at;
    }
}

impl CodeMemory for TroubledMemory {
    fn permit(&self, step: CodeStep) -> Result<(), String> {
        let trouble = *self.0.lock().unwrap();
        if trouble == Some(step) { Err("planted".into()) } else { Ok(()) }
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
        let mut commons = Commons::of_machine(VectorWidth::default());
        commons.cache = Arc::new(KernelCache::default().in_memory(memory.clone()));
        let service = Service::of_store(Arc::new(MemoryStore::default()), Arc::new(commons)).unwrap();
        let mut rig = Rig { service, owner: Owner::new(), memory };
        for (model, intensity) in [("level", "v0"), ("slope", "v0 + 0.125 * x")] {
            let checked = rig.check(model, intensity).unwrap();
            rig.service.put_model(&mut rig.owner, &name(model), &Expected::Anything, checked).unwrap();
        }
        rig.service.put_source(&mut rig.owner, &name("eye"), source(WIDTH), None, Keeping::Declared).unwrap();
        rig
    }

    fn check(&self, model: &str, intensity: &str) -> Result<(ModelEntry, ModelAnswer), Problem> {
        let document = json!({"name": model, "coordinates": ["x", "y"], "channels": ["phi"],
                              "parameters": {"v0": {"start": 1}}, "model": {"intensity": intensity}});
        let workers = self.service.workshop.at_once();
        self.service.check_model(&name(model), Media::Json, &document.to_string(), &workers)
    }

    fn put_session(&mut self, session: &str, model: &str) -> Result<(), Problem> {
        let document = serde_json::from_value(json!({"source": "eye", "model": model})).unwrap();
        let put = self.service.put_session(&mut self.owner, &name(session), document, None, None, Keeping::Declared);
        put.map(drop)
    }

    fn swap(&mut self, session: &str, model: &str) -> Result<(), Problem> {
        let (running, entry) = (self.service.session(session)?, self.service.registry.get(model)?);
        let prepared = running.prepare_swap(&entry, SlowModels::Allowed, &self.service.workshop.at_once())?;
        self.service.commit_swap(&mut self.owner, session, &running, &entry, prepared).map(drop)
    }

    /// What that session says of a frame, which all sessions see.
    fn push(&self, session: &str, plane: Plane) -> Value {
        let running = self.service.session(session).unwrap();
        let rows = plane.buffer.bytes().len() / WIDTH;
        let frame = Frame::new(&[WIDTH, rows], vec![plane]).unwrap();
        let (sender, answer) = oneshot::channel();
        let reply = Reply { session: running.inbox().clone(), sender };
        running.source().source.push(Captured { frame, file: None, truth: None }, reply).unwrap();
        serde_json::to_value(&*answer.blocking_recv().unwrap()).unwrap()
    }

    /// The model that fits a frame in which all pixels have the same light, and what it finds, rounded.
    fn fitted(&self, session: &str) -> (String, f64) {
        let plane = Plane::owned(isophote_jit::PixelFormat::U8, vec![100; WIDTH * 6], WIDTH);
        let estimate = self.push(session, plane);
        let model = estimate["model"].as_str().unwrap().split('@').next().unwrap().to_string();
        (model, estimate["parameters"]["v0"].as_f64().unwrap().round())
    }
}

#[test]
fn without_memory_for_code_sessions_keep_the_kernels_that_they_have() {
    for step in [CodeStep::Map, CodeStep::Protect] {
        let mut rig = Rig::start();
        rig.put_session("one", "level").unwrap();
        assert_eq!(rig.fitted("one"), ("level".into(), 100.0));
        rig.memory.trouble(Some(step));
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
