//! The owner under clients that come in any order, a disk that fills up, and starts that die: commands drawn from a seed, each
//! answered as a few lines of plain bookkeeping say, and everything that is declared seen where it should be after each of them.
//! `ISOPHOTE_COMMANDS` says how many (a million takes minutes), `ISOPHOTE_SEED` which.

#![allow(clippy::unwrap_used)]

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use isophote_jit::VectorWidth;
use isophote_wire::{ModelAnswer, SessionState};
use serde_json::json;

use super::Service;
use super::tests::Disk;
use crate::compiler::Owner;
use crate::declared::Keeping;
use crate::limits::LIMITS;
use crate::name::Name;
use crate::problem::Problem;
use crate::registry::{Expected, Media, ModelEntry};
use crate::session::SlowModels;

const COMMANDS: u64 = 4_000;
/// Names of each kind, and clients that prepare a model now and put it later.
const NAMES: u64 = 3;
const CLIENTS: u64 = 4;
/// A swap waits a second for a frame, which these sources do not have.
const COMMANDS_FOR_A_SWAP: u64 = 5_000;

/// What clients ask for, and what happens to the service. Numbers are names: model 2 is `m2`.
#[derive(Clone, Copy, Debug)]
enum Command {
    /// A client has a document checked, whose only number is `start`.
    Prepare {
        client: u64,
        model: u64,
        start: u64,
    },
    /// It puts what it prepared, where it wants to find nothing or does not care.
    Put {
        client: u64,
        is_new: bool,
    },
    RollBack {
        model: u64,
        version: u64,
    },
    RemoveModel {
        model: u64,
    },
    PutSource {
        source: u64,
        width: u64,
    },
    RemoveSource {
        source: u64,
    },
    /// Of a named source, or of one of its own.
    PutSession {
        session: u64,
        model: u64,
        source: Option<u64>,
    },
    Swap {
        session: u64,
        model: u64,
    },
    RemoveSession {
        session: u64,
    },
    FillDisk,
    EmptyDisk,
    /// Of the process, at once; it may have lived for long enough before.
    Kill {
        has_lived: bool,
    },
}

/// Numbers that follow from a seed.
struct Draws(u64);

impl Draws {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut bits = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (bits ^ (bits >> 31)) % limit
    }

    fn command(&mut self) -> Command {
        if self.below(COMMANDS_FOR_A_SWAP) == 0 {
            return Command::Swap { session: self.below(NAMES), model: self.below(NAMES) };
        }
        match self.below(100) {
            0..15 => Command::Prepare { client: self.below(CLIENTS), model: self.below(NAMES), start: self.below(50) },
            15..30 => Command::Put { client: self.below(CLIENTS), is_new: self.below(4) == 0 },
            30..35 => Command::RollBack { model: self.below(NAMES), version: self.below(6) },
            35..42 => Command::RemoveModel { model: self.below(NAMES) },
            42..54 => Command::PutSource { source: self.below(NAMES), width: 8 + self.below(9) },
            54..62 => Command::RemoveSource { source: self.below(NAMES) },
            62..76 => {
                let (model, named) = (self.below(NAMES), self.below(3) > 0);
                let source = named.then(|| self.below(NAMES));
                Command::PutSession { session: self.below(NAMES), model, source }
            }
            76..90 => Command::RemoveSession { session: self.below(NAMES) },
            90..93 => Command::FillDisk,
            93..99 => Command::EmptyDisk,
            _ if self.below(4) == 0 => Command::Kill { has_lived: self.below(2) == 0 },
            _ => Command::EmptyDisk,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Runs {
    Yes,
    /// Its source is gone.
    Failed,
    /// What it may have killed stays stopped.
    Stopped,
}

#[derive(Clone, Debug)]
struct Declared {
    /// Of the document, and the one that runs.
    models: [u64; 2],
    start: u64,
    source: Option<u64>,
    runs: Runs,
}

/// What there should be.
#[derive(Default)]
struct Books {
    /// Numbers of the documents by version, from 1, and the version in force.
    models: BTreeMap<u64, (Vec<u64>, usize)>,
    sources: BTreeSet<u64>,
    sessions: BTreeMap<u64, Declared>,
    is_full: bool,
    /// Starts that died.
    died: u32,
}

impl Books {
    fn start_of(&self, model: u64) -> Option<u64> {
        self.models.get(&model).map(|(starts, version)| starts[version - 1])
    }

    fn is_used(&self, model: u64) -> bool {
        // One that runs needs the model that it has, and no longer the document's after a swap.
        let needed = |session: &Declared| match session.runs {
            Runs::Yes => session.models[1] == model,
            _ => session.models.contains(&model),
        };
        self.sessions.values().any(needed)
    }

    fn feeds(&self, source: u64) -> bool {
        self.sessions.values().any(|session| session.source == Some(source) && session.runs == Runs::Yes)
    }

    /// The next start of the service, after the last one died.
    fn start(&mut self) {
        let runnable = self.sessions.values().filter(|session| session.runs != Runs::Stopped).count();
        let is_held = self.died >= LIMITS.starts_died;
        self.died = if runnable == 0 || is_held { 0 } else { self.died + 1 };
        for session in self.sessions.values_mut() {
            session.runs = match session.runs {
                Runs::Stopped => Runs::Stopped,
                _ if is_held => Runs::Stopped,
                _ if session.source.is_some_and(|source| !self.sources.contains(&source)) => Runs::Failed,
                _ => Runs::Yes,
            };
        }
    }
}

type Checked = (ModelEntry, ModelAnswer);

struct Simulation {
    disk: Arc<Disk>,
    service: Service,
    owner: Owner,
    books: Books,
    pending: BTreeMap<u64, (u64, u64, Checked)>,
    digests: BTreeMap<(u64, u64), String>,
    /// Of each start of a session.
    epochs: BTreeSet<(String, u64)>,
}

fn name(kind: &str, number: u64) -> Name {
    Name::parse(&format!("{kind}{number}")).unwrap()
}

fn code<T>(answer: &Result<T, Problem>) -> &'static str {
    answer.as_ref().map_or_else(|problem| problem.code, |_| "done")
}

/// What is right where the disk refuses whatever else would be done.
fn on_disk(is_full: bool) -> &'static str {
    if is_full { "storage" } else { "done" }
}

fn source(width: u64) -> serde_json::Value {
    json!({"kind": "pushed", "width": width, "height": 6, "format": "u8"})
}

impl Simulation {
    fn new() -> Simulation {
        let disk = Arc::new(Disk::default());
        let service = Service::of_store(disk.clone(), VectorWidth::default()).unwrap();
        let (books, pending) = (Books::default(), BTreeMap::new());
        let (digests, epochs) = (BTreeMap::new(), BTreeSet::new());
        Simulation { disk, service, owner: Owner::new(), books, pending, digests, epochs }
    }

    fn checked(&self, model: u64, start: u64) -> Checked {
        let document = json!({"name": format!("m{model}"), "coordinates": ["x", "y"], "channels": ["phi"],
                              "parameters": {"v0": {"start": start}}, "model": {"intensity": "v0"}});
        let workers = self.service.workshop.at_once();
        self.service.check_model(&name("m", model), Media::Json, &document.to_string(), &workers).unwrap()
    }

    /// The answer, and the one that is right.
    fn run(&mut self, command: Command) -> (&'static str, &'static str) {
        let is_full = self.books.is_full;
        match command {
            Command::Prepare { client, model, start } => {
                let checked = self.checked(model, start);
                self.digests.insert((model, start), checked.0.model.digest().to_string());
                self.pending.insert(client, (model, start, checked));
                ("done", "done")
            }
            Command::Put { client, is_new } => {
                let Some((model, start, checked)) = self.pending.remove(&client) else { return ("done", "done") };
                let expected = if is_new { Expected::Nothing } else { Expected::Anything };
                let answer = self.service.put_model(&mut self.owner, &name("m", model), &expected, checked);
                let is_stale = is_new && self.books.models.contains_key(&model);
                let right = if is_stale { "stale" } else { on_disk(is_full) };
                if right == "done" {
                    let (starts, version) = self.books.models.entry(model).or_default();
                    starts.push(start);
                    *version = starts.len();
                    assert_eq!(answer.as_ref().unwrap().2.version, *version as u64);
                }
                (code(&answer), right)
            }
            Command::RollBack { model, version } => {
                let Some((starts, _)) = self.books.models.get(&model) else { return ("done", "done") };
                // One of the newest, which are kept.
                let version = starts.len().saturating_sub(version as usize).max(1);
                let checked = self.checked(model, self.books.models[&model].0[version - 1]);
                let answer = self.service.roll_back_model(
                    &mut self.owner,
                    &name("m", model),
                    &Expected::Something,
                    version as u64,
                    checked,
                );
                if !is_full {
                    self.books.models.get_mut(&model).unwrap().1 = version;
                }
                (code(&answer), on_disk(is_full))
            }
            Command::RemoveModel { model } => {
                let answer = self.service.remove_model(&mut self.owner, &name("m", model), &Expected::Anything);
                let right = match self.books.models.contains_key(&model) {
                    false => "unknown-name",
                    true if self.books.is_used(model) => "in-use",
                    true => on_disk(is_full),
                };
                if right == "done" {
                    self.books.models.remove(&model);
                }
                (code(&answer), right)
            }
            Command::PutSource { source: number, width } => {
                let document = serde_json::from_value(source(width)).unwrap();
                let name = name("c", number);
                let answer = self.service.put_source(&mut self.owner, &name, document, None, Keeping::Declared);
                let right = if self.books.feeds(number) { "in-use" } else { on_disk(is_full) };
                if right == "done" {
                    self.books.sources.insert(number);
                }
                (code(&answer), right)
            }
            Command::RemoveSource { source: number } => {
                let answer = self.service.remove_source(&mut self.owner, &name("c", number));
                let right = match self.books.sources.contains(&number) {
                    false => "unknown-name",
                    true if self.books.feeds(number) => "in-use",
                    true => on_disk(is_full),
                };
                if right == "done" {
                    self.books.sources.remove(&number);
                }
                (code(&answer), right)
            }
            Command::PutSession { session, model, source: named } => self.put_session(session, model, named),
            Command::Swap { session, model } => self.swap(session, model),
            Command::RemoveSession { session } => {
                let answer = self.service.remove_session(&mut self.owner, &name("s", session));
                let right = match self.books.sessions.contains_key(&session) {
                    false => "unknown-name",
                    true => on_disk(is_full),
                };
                if right == "done" {
                    self.books.sessions.remove(&session);
                }
                let answered = code(&answer);
                drop(answer.map(|ended| ended.blocking_recv()));
                (answered, right)
            }
            Command::FillDisk | Command::EmptyDisk => {
                self.books.is_full = matches!(command, Command::FillDisk);
                self.disk.fill(self.books.is_full);
                ("done", "done")
            }
            Command::Kill { has_lived } => {
                self.kill(has_lived);
                ("done", "done")
            }
        }
    }

    fn put_session(&mut self, session: u64, model: u64, named: Option<u64>) -> (&'static str, &'static str) {
        let from = named.map_or_else(|| source(8), |number| json!(format!("c{number}")));
        let document = serde_json::from_value(json!({"source": from, "model": format!("m{model}")})).unwrap();
        let name = name("s", session);
        let answer = self.service.put_session(&mut self.owner, &name, document, None, None, Keeping::Declared);
        let is_known = named.is_none_or(|number| self.books.sources.contains(&number));
        let right = match self.books.start_of(model) {
            None => "unknown-name",
            Some(_) if !is_known => "unknown-name",
            Some(start) => {
                if !self.books.is_full {
                    let declared = Declared { models: [model; 2], start, source: named, runs: Runs::Yes };
                    self.books.sessions.insert(session, declared);
                }
                on_disk(self.books.is_full)
            }
        };
        let answered = code(&answer);
        if let Ok((_, ended)) = answer {
            if let Some(ended) = ended {
                ended.blocking_recv().ok(); // where nobody could wait for it, it ends alone
            }
            self.begun(session);
        }
        // A full disk may be found before or after a name that is unknown.
        let is_either = self.books.is_full && right == "unknown-name" && answered == "storage";
        (answered, if is_either { answered } else { right })
    }

    fn swap(&mut self, session: u64, model: u64) -> (&'static str, &'static str) {
        let Some(declared) = self.books.sessions.get_mut(&session).filter(|one| one.runs == Runs::Yes) else {
            return ("done", "done");
        };
        let Ok(entry) = self.service.registry.get(&format!("m{model}")) else { return ("done", "done") };
        let running = self.service.session(&format!("s{session}")).unwrap();
        let workers = self.service.workshop.at_once();
        let prepared = running.prepare_swap(&entry, SlowModels::Allowed, &workers).unwrap();
        let answer = self.service.commit_swap(&mut self.owner, &format!("s{session}"), &running, &entry, prepared);
        if !self.books.is_full {
            let (starts, version) = &self.books.models[&model];
            (declared.models[1], declared.start) = (model, starts[version - 1]);
        }
        let answered = code(&answer);
        drop(answer.map(|swapped| swapped.blocking_recv()));
        (answered, on_disk(self.books.is_full))
    }

    /// Nothing more reaches the disk; then everything that was declared runs again, or says why it does not.
    fn kill(&mut self, has_lived: bool) {
        self.books.is_full = false;
        if has_lived {
            self.disk.fill(false);
            self.service.lived();
            self.books.died = 0;
        }
        self.disk.fill(true);
        self.service.stop();
        self.disk.fill(false);
        self.pending.clear();
        self.service = Service::of_store(self.disk.clone(), VectorWidth::default()).unwrap();
        for (source, _) in self.service.awaited_sources() {
            self.service.restore_source(&mut self.owner, &source, Ok(None));
        }
        for (session, _) in self.service.awaited_sessions() {
            self.service.restore_session(&mut self.owner, &session, Ok(None));
        }
        self.books.start();
        let runs = self.books.sessions.iter().filter(|(_, session)| session.runs == Runs::Yes);
        runs.map(|(session, _)| *session).collect::<Vec<_>>().into_iter().for_each(|session| self.begun(session));
    }

    /// A session has just begun: under an epoch that none had before.
    fn begun(&mut self, session: u64) {
        let view = self.service.session_view(&format!("s{session}")).unwrap();
        assert!(self.epochs.insert((view.node.clone(), view.epoch.unwrap())), "{view:?}");
    }

    /// Everything that there should be, and nothing else.
    fn check(&mut self) {
        let numbered = |kind: &str, name: &str| name.strip_prefix(kind).and_then(|number| number.parse::<u64>().ok());
        let entries = self.service.registry.list();
        let models: BTreeMap<u64, (u64, String)> = entries
            .iter()
            .filter_map(|entry| {
                Some((numbered("m", entry.name.as_str())?, (entry.version, entry.model.digest().into())))
            })
            .collect();
        let wanted = self.books.models.iter().map(|(model, (starts, version))| {
            (*model, (*version as u64, self.digests[&(*model, starts[version - 1])].clone()))
        });
        assert_eq!(models, wanted.collect(), "models");
        let sources: BTreeSet<u64> =
            self.service.source_views().iter().filter_map(|view| numbered("c", &view.name)).collect();
        assert_eq!(sources, self.books.sources, "sources");
        let views = self.service.session_views();
        assert_eq!(views.len(), self.books.sessions.len(), "sessions");
        for view in views {
            let declared = &self.books.sessions[&numbered("s", &view.name).unwrap()];
            let digest = &self.digests[&(declared.models[1], declared.start)];
            assert_eq!(&view.active_digest, digest, "{view:?}");
            let runs = match view.state {
                SessionState::Stopped => Runs::Stopped,
                SessionState::Failed => Runs::Failed,
                _ => Runs::Yes,
            };
            assert_eq!(runs, declared.runs, "{view:?}");
            assert_eq!(view.reason.is_none(), runs == Runs::Yes, "{view:?}");
        }
    }
}

#[test]
fn the_owner_does_what_its_books_say() {
    let number = |name: &str, usual: u64| std::env::var(name).map_or(usual, |text| text.parse().unwrap());
    let (commands, seed) = (number("ISOPHOTE_COMMANDS", COMMANDS), number("ISOPHOTE_SEED", 1));
    let (mut draws, mut simulation, mut refused) = (Draws(seed), Simulation::new(), 0);
    for step in 0..commands {
        let command = draws.command();
        let (answered, right) = simulation.run(command);
        assert_eq!(answered, right, "seed {seed}, command {step}: {command:?}");
        refused += u64::from(answered != "done");
        simulation.check();
    }
    simulation.service.stop();
    assert!(refused * 20 > commands, "only {refused} of {commands} were refused: the simulation shows little");
}
