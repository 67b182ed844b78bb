//! A camera's driver hangs: users can delete, replace and stop, and nothing waits for it.

#![allow(clippy::unwrap_used)]

use std::sync::Arc;
use std::time::Duration;

use isophote_jit::VectorWidth;
use serde_json::json;

use super::Service;
use super::tests::checked_at_once;
use crate::http::preconditions::Preconditions;
use crate::name::Name;
use crate::service::compiler::Owner;
use crate::service::declared::Keeping;
use crate::service::machine::Machine;
use crate::source::hanging_tests::{TestDriver, opened};
use crate::store::MemoryStore;

struct Rig {
    service: Service,
    owner: Owner,
}

impl Rig {
    fn start() -> Rig {
        let machine = Arc::new(Machine::of_machine(VectorWidth::default()));
        let service = Service::of_store(Arc::new(MemoryStore::default()), machine).unwrap();
        let level = json!({"name": "level", "coordinates": ["x", "y"], "channels": ["phi"],
                           "parameters": {"v0": {"start": 1}}, "model": {"intensity": "v0"}});
        let (name, mut owner) = (Name::parse("level").unwrap(), Owner::new());
        let prepared = checked_at_once(&service, "level", &level).unwrap();
        service.put_model(&mut owner, &name, &Preconditions::default(), prepared).unwrap();
        Rig { service, owner }
    }

    /// Runs a source of that driver's camera, and a session that receives its frames.
    fn run(&mut self, driver: &Arc<TestDriver>) {
        let (eye, one) = (Name::parse("eye").unwrap(), Name::parse("one").unwrap());
        let camera = serde_json::from_value(json!({"kind": "camera", "device": "/dev/video0"})).unwrap();
        let opened = opened(driver, &self.service.machine.drivers);
        self.service.put_source(&mut self.owner, &eye, camera, Some(opened), Keeping::Declared).unwrap();
        let session = serde_json::from_value(json!({"source": "eye", "model": "level"})).unwrap();
        self.service.put_session(&mut self.owner, &one, session, None, None, Keeping::Declared).unwrap();
        while self.service.session_view("one").unwrap().frames < 3 {
            std::thread::park_timeout(Duration::from_millis(5));
        }
    }

    /// Makes the driver's calls hang; returns when no more frames arrive.
    fn hang(&self, driver: &TestDriver) {
        driver.hang(0);
        let frames = || self.service.source_view("eye").unwrap().frames;
        let mut before = frames();
        loop {
            std::thread::park_timeout(Duration::from_millis(20));
            match frames() {
                now if now == before => return,
                now => before = now,
            }
        }
    }
}

#[test]
fn hanging_camera_blocks_neither_deletion_nor_replacement_nor_stop() {
    let mut rig = Rig::start();
    let (first, second) = (Arc::new(TestDriver::default()), Arc::new(TestDriver::default()));
    rig.run(&first);
    rig.hang(&first);
    let given_up = |rig: &Rig| rig.service.machine.drivers.given_up();
    let (eye, one) = (Name::parse("eye").unwrap(), Name::parse("one").unwrap());
    let ended = rig.service.remove_session(&mut rig.owner, &one).unwrap();
    ended.blocking_recv().unwrap();
    rig.service.remove_source(&mut rig.owner, &eye).unwrap();
    assert_eq!(given_up(&rig), 1, "its thread is in the call still");
    rig.run(&second);
    rig.hang(&second);
    rig.service.stop();
    assert_eq!(given_up(&rig), 2);
    first.release();
    second.release();
    while given_up(&rig) > 0 {
        std::thread::yield_now();
    }
}
