//! A camera's driver never comes back: what users do about it works, and nothing waits for it.

#![allow(clippy::unwrap_used)]

use std::sync::Arc;
use std::time::Duration;

use isophote_jit::VectorWidth;
use serde_json::json;

use super::Service;
use super::tests::checked_at_once;
use crate::commons::Commons;
use crate::compiler::Owner;
use crate::declared::Keeping;
use crate::name::Name;
use crate::preconditions::Preconditions;
use crate::source::hanging_tests::{TestDriver, opened};
use crate::store::MemoryStore;

struct Rig {
    service: Service,
    owner: Owner,
}

impl Rig {
    fn start() -> Rig {
        let commons = Arc::new(Commons::of_machine(VectorWidth::default()));
        let service = Service::of_store(Arc::new(MemoryStore::default()), commons).unwrap();
        let level = json!({"name": "level", "coordinates": ["x", "y"], "channels": ["phi"],
                           "parameters": {"v0": {"start": 1}}, "model": {"intensity": "v0"}});
        let (name, mut owner) = (Name::parse("level").unwrap(), Owner::new());
        let prepared = checked_at_once(&service, "level", &level).unwrap();
        service.put_model(&mut owner, &name, &Preconditions::default(), prepared).unwrap();
        Rig { service, owner }
    }

    /// A source of that driver's camera, and a session that sees frames of it.
    fn run(&mut self, driver: &Arc<TestDriver>) {
        let (eye, one) = (Name::parse("eye").unwrap(), Name::parse("one").unwrap());
        let camera = serde_json::from_value(json!({"kind": "camera", "device": "/dev/video0"})).unwrap();
        let opened = opened(driver, &self.service.commons.drivers);
        self.service.put_source(&mut self.owner, &eye, camera, Some(opened), Keeping::Declared).unwrap();
        let session = serde_json::from_value(json!({"source": "eye", "model": "level"})).unwrap();
        self.service.put_session(&mut self.owner, &one, session, None, None, Keeping::Declared).unwrap();
        while self.service.session_view("one").unwrap().frames < 3 {
            std::thread::park_timeout(Duration::from_millis(5));
        }
    }

    /// Calls of that driver do not return from now on; until frames have ceased to come.
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
fn a_session_whose_camera_hangs_is_deleted_its_source_put_anew_and_the_service_stopped() {
    let mut rig = Rig::start();
    let (first, second) = (Arc::new(TestDriver::default()), Arc::new(TestDriver::default()));
    rig.run(&first);
    rig.hang(&first);
    let given_up = |rig: &Rig| rig.service.commons.drivers.given_up();
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
