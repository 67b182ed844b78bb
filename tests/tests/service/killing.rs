//! kill −9 amid changes of every kind: acknowledged changes persist, others are made or not, nothing is torn, and
//! declared sessions run. Two clients change models, sources and sessions of their own meanwhile. `cargo run --release
//! -p isophote-tests --example kills -- 1000` does it a thousand times.

use std::path::Path;
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::time::Duration;

use isophote_tests::Service;
use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::{Rng, SeedableRng};
use serde_json::{Value, json};

use crate::client::{Running, synthetic};

/// State of one name: the acknowledged value, and the change pending when the process died.
#[derive(Clone, Debug, Default, PartialEq)]
struct NameState<T> {
    acknowledged: Option<T>,
    requested: Option<Option<T>>,
}

impl<T: Clone + PartialEq + std::fmt::Debug> NameState<T> {
    /// Requests a change; false if the process died before it answered.
    fn change(&mut self, to: Option<T>, statuses: &[u16], request: impl FnOnce() -> Option<u16>) -> bool {
        self.requested = Some(to.clone());
        let Some(status) = request() else { return false };
        assert!(statuses.contains(&status), "{status} of {to:?}");
        if status < 300 {
            self.acknowledged = to;
        }
        self.requested = None;
        true
    }

    /// After the restart: the value found is the acknowledged or the pending one.
    fn check_after_restart(&mut self, what: &str, found: Option<T>) -> Outcome {
        let requested = self.requested.take();
        if found == self.acknowledged {
            return if requested.is_some() { Outcome::Undone } else { Outcome::Kept };
        }
        assert_eq!(Some(&found), requested.as_ref(), "{what}: {:?} was acknowledged", self.acknowledged);
        self.acknowledged = found;
        Outcome::Done
    }
}

/// Outcome for a name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outcome {
    Kept,
    Undone,
    Done,
}

/// A client with its own names.
struct Client {
    number: u64,
    random: Pcg64Mcg,
    /// The number in the document.
    model: NameState<u64>,
    /// Documents by version, from the first.
    versions: Vec<u64>,
    rate: NameState<u64>,
    /// The rate and the model.
    session: NameState<(u64, &'static str)>,
    /// The last epoch seen.
    epoch: u64,
}

/// Counts of outcomes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Changes that were acknowledged.
    pub acknowledged: usize,
    /// Changes pending at a kill that were found applied.
    pub done: usize,
    /// Changes pending at a kill that were not.
    pub undone: usize,
}

fn document(start: u64) -> Value {
    json!({"name": "level", "coordinates": ["x", "y"], "channels": ["phi"], "parameters": {"v0": {"start": start}},
           "model": {"intensity": "v0"}})
}

impl Client {
    fn new(number: u64, seed: u64) -> Client {
        Client {
            number,
            random: Pcg64Mcg::seed_from_u64(seed ^ number),
            model: NameState::default(),
            versions: Vec::new(),
            rate: NameState::default(),
            session: NameState::default(),
            epoch: 0,
        }
    }

    fn path(&self, kind: &str) -> String {
        format!("/v1/{kind}/of-{}", self.number)
    }

    /// Makes changes until the process is gone; returns the number acknowledged.
    fn run(&mut self, service: &Running) -> usize {
        let mut acknowledged = 0;
        while self.step(service) {
            acknowledged += 1;
        }
        acknowledged
    }

    fn step(&mut self, service: &Running) -> bool {
        let request = |method: &str, path: &str, document: Value| {
            let json = [("content-type", "application/json")];
            let answer = service.try_request(method, path, &json, document.to_string().as_bytes());
            answer.ok().map(|answer| answer.status)
        };
        let number = u64::from(self.random.next_u32() >> 1);
        let (model, source, session) = (self.path("models"), self.path("sources"), self.path("sessions"));
        let rate = 100 + number % 100;
        match number % 9 {
            0 | 1 => {
                let is_done = self.model.change(Some(number), &[200, 201], || request("PUT", &model, document(number)));
                self.versions.push(number);
                is_done
            }
            2 if self.model.acknowledged.is_some() && !self.versions.is_empty() => {
                let version = number as usize % self.versions.len();
                let path = format!("{model}:rollback");
                let to = Some(self.versions[version]);
                self.model.change(to, &[200, 404], || request("POST", &path, json!({"version": version + 1})))
            }
            3 => {
                self.versions.clear();
                self.model.change(None, &[204, 404], || request("DELETE", &model, Value::Null))
            }
            4 => self.rate.change(Some(rate), &[200, 201], || request("PUT", &source, synthetic("fit", rate as f64))),
            5 => self.rate.change(None, &[204, 404], || request("DELETE", &source, Value::Null)),
            6 => {
                let document = json!({"source": synthetic("fit", rate as f64), "model": "spot"});
                self.session.change(Some((rate, "spot")), &[200, 201], || request("PUT", &session, document))
            }
            7 => match self.session.acknowledged {
                Some((rate, before)) => {
                    let to = if before == "spot" { "gaussian" } else { "spot" };
                    let path = format!("{session}/model");
                    // 409: it is restarting.
                    self.session.change(Some((rate, to)), &[200, 409], || {
                        // For a swap interrupted by the end of the service, only the next start shows whether it was
                        // kept.
                        request("PUT", &path, json!({"model": to})).filter(|status| *status != 503)
                    })
                }
                None => true,
            },
            8 if number % 4 == 0 => self.session.change(None, &[204, 404], || request("DELETE", &session, Value::Null)),
            _ => true,
        }
    }

    /// Compares the service's state with the expected one.
    fn check(&mut self, service: &Running, tally: &mut Tally) {
        let found = |path: &str| {
            let answer = service.get(path);
            (answer.status == 200).then(|| answer.json())
        };
        let model = found(&self.path("models"));
        let start =
            model.as_ref().and_then(|model| model["parameters"]["v0"]["start"].as_f64()).map(|start| start as u64);
        let of_model = self.model.check_after_restart("model", start);
        let rate = |document: &Value| document["rate_hz"].as_f64().unwrap() as u64;
        let source = found(&self.path("sources"));
        let of_source = self.rate.check_after_restart("source", source.as_ref().map(rate));
        let session = found(&self.path("sessions"));
        let of = |view: &Value| {
            let model = if view["active_model"] == "spot" { "spot" } else { "gaussian" };
            (rate(&view["source"]), model)
        };
        let of_session = self.session.check_after_restart("session", session.as_ref().map(of));
        if session.is_some() {
            // Declared sessions run.
            let name = format!("of-{}", self.number);
            let view = service.wait_for(&name, |view| view["frames"].as_u64() > Some(1));
            let epoch = view["epoch"].as_u64().unwrap();
            assert!(epoch > self.epoch, "{view}");
            self.epoch = epoch;
        }
        // Versions are the documents put, in order; a pending one that was not applied is not the last of them.
        self.versions = match &model {
            None => Vec::new(),
            Some(_) => self.versions_of(service),
        };
        for outcome in [of_model, of_source, of_session] {
            tally.done += usize::from(outcome == Outcome::Done);
            tally.undone += usize::from(outcome == Outcome::Undone);
        }
    }

    /// The numbers in the documents of all versions, by rolling back to one after the other.
    fn versions_of(&self, service: &Running) -> Vec<u64> {
        let path = self.path("models");
        let list = service.get(&format!("{path}/versions")).expect(200);
        let items = list["items"].as_array().unwrap();
        let active = items.iter().find(|item| item["active"] == true).unwrap()["version"].as_u64().unwrap();
        // Collected versions cannot be restored.
        if list["collected"] != 0 {
            assert_eq!(service.delete(&path).status, 204);
            service.put(&path, &document(self.model.acknowledged.unwrap())).expect(201);
            return vec![self.model.acknowledged.unwrap()];
        }
        let back = |version: u64| {
            let (path, body) = (format!("{path}:rollback"), json!({"version": version}).to_string());
            service.request("POST", &path, &[("content-type", "application/json")], body.as_bytes()).expect(200)
        };
        let start = |version: u64| {
            back(version);
            service.get(&path).expect(200)["parameters"]["v0"]["start"].as_f64().unwrap() as u64
        };
        let starts = (1..=items.len() as u64).map(start).collect();
        back(active);
        starts
    }
}

/// Kills and restarts the service that many times.
pub fn kill(program: &Path, folder: &Path, kills: usize, seed: u64) -> Tally {
    let data = folder.to_str().unwrap();
    let serve = || Service::start(program, &["--data", data, "--vector-width", "128"], folder).unwrap();
    let mut clients = [Client::new(1, seed), Client::new(2, seed)];
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut tally = Tally::default();
    for kill in 0..=kills {
        let mut process = serve();
        let service = Running::at(process.address());
        clients.iter_mut().for_each(|client| client.check(&service, &mut tally));
        if kill == kills {
            break;
        }
        if kill % 2 == 1 {
            // Three failed starts in a row would keep the sessions from running.
            let id = process.child().id().to_string();
            assert!(std::process::Command::new("kill").args(["-TERM", &id]).status().unwrap().success());
            assert!(process.child().wait().unwrap().success());
            process = serve();
        }
        let service = Running::at(process.address());
        let after = Duration::from_micros(u64::from(random.next_u32() % 150_000));
        let acknowledged: usize = std::thread::scope(|scope| {
            let running = clients.each_mut().map(|client| scope.spawn(|| client.run(&service)));
            let (end, ended) = sync_channel::<()>(0);
            assert_eq!(ended.recv_timeout(after), Err(RecvTimeoutError::Timeout));
            drop(end);
            process.child().kill().unwrap();
            process.child().wait().unwrap();
            running.into_iter().map(|one| one.join().unwrap()).sum()
        });
        tally.acknowledged += acknowledged;
    }
    tally
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::client::Folder;

    #[test]
    fn nothing_acknowledged_is_lost_in_25_kills() {
        const SEED: u64 = 20_261_123;
        let folder = Folder::new("kills");
        let tally = kill(&isophote_tests::program().unwrap(), &folder.0, 25, SEED);
        assert!(tally.acknowledged > 50 && tally.done + tally.undone > 10, "{tally:?}, seed {SEED}");
    }
}
