//! `Tenants`: a service for each tenant, so that no tenant sees, changes or takes the names of another.
//!
//! Requests extract the [`App`] of their token's tenant. A tenant with a token or a folder is opened at startup, else with its
//! first request. Declarations and the compile thread are per tenant; resources of the machine are shared ([`Machine`]).

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, PoisonError, RwLock};
use std::thread;

use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use isophote_capture::ReadableFolder;
use tokio::sync::{mpsc, watch};

use crate::access::{Access, DEFAULT_TENANT, Recordings, Visitor};
use crate::http::app::App;
use crate::http::restore::restore;
use crate::limits::LIMITS;
use crate::name::Name;
use crate::problem::Problem;
use crate::recording::{RecordingFolder, RecordingSpace};
use crate::service::Service;
use crate::service::machine::Machine;
use crate::service::watchdog;

/// The folder of all tenants but the default one, in the data folder.
const FOLDER: &str = "tenants";

/// All tenants of one process.
pub struct Tenants {
    machine: Arc<Machine>,
    /// The data folder, if any.
    data: Option<PathBuf>,
    /// Disk space for the recordings of all tenants.
    space: Arc<RecordingSpace>,
    access: Arc<Access>,
    apps: RwLock<BTreeMap<Name, App>>,
    /// Tenants are opened one at a time.
    opening: tokio::sync::Mutex<()>,
    /// Held by every stream.
    stream: mpsc::WeakSender<()>,
    stopped: watch::Receiver<bool>,
}

impl Tenants {
    /// Begins with the default tenant, to which `app` gives the resources of the machine. Nothing runs yet.
    pub fn new(
        machine: Arc<Machine>,
        (data, space): (Option<PathBuf>, Arc<RecordingSpace>),
        access: Arc<Access>,
        app: App,
        (stream, stopped): (mpsc::WeakSender<()>, watch::Receiver<bool>),
    ) -> Tenants {
        // With tokens there are several tenants, of which this is one.
        let own = match &access.keyring {
            Some(_) => app.beside(app.service.clone(), (app.recordings.clone(), app.folder.clone())),
            None => app,
        };
        let apps = Name::parse(DEFAULT_TENANT).map(|name| (name, own)).into_iter().collect();
        Tenants {
            machine,
            data,
            space,
            access,
            apps: RwLock::new(apps),
            opening: tokio::sync::Mutex::default(),
            stream,
            stopped,
        }
    }

    /// Restores the declarations of all known tenants. A tenant whose folder cannot be read is logged and delays no other.
    pub async fn begin(self: Arc<Self>) {
        self.list().into_iter().for_each(|app| self.run(app));
        for name in self.known() {
            self.app(&name).await.map(drop).unwrap_or_else(|problem| {
                tracing::error!(tenant = name, "nothing of it runs: {}", problem.detail);
            });
        }
    }

    /// Tenants of tokens and folders.
    fn known(&self) -> Vec<String> {
        let Some(keyring) = &self.access.keyring else { return Vec::new() };
        let folders = self.data.as_ref().and_then(|data| std::fs::read_dir(data.join(FOLDER)).ok());
        let names = folders.into_iter().flatten().flatten().filter_map(|folder| folder.file_name().into_string().ok());
        let mut names: Vec<String> = names.filter(|name| Name::parse(name).is_some()).collect();
        names.extend(keyring.tenants());
        names.sort();
        names.dedup();
        names
    }

    fn run(&self, app: App) {
        let Some(stream) = self.stream.upgrade() else { return }; // the service stops
        tokio::spawn(watchdog::watch(app.service.clone()));
        tokio::spawn(restore(app.held(stream), self.stopped.clone()));
    }

    fn list(&self) -> Vec<App> {
        self.all().into_iter().map(|(_, app)| app).collect()
    }

    fn get(&self, tenant: &str) -> Option<App> {
        let name = Name::parse(tenant)?;
        self.apps.read().unwrap_or_else(PoisonError::into_inner).get(&name).cloned()
    }

    /// The app of a tenant, which is opened if necessary.
    async fn app(self: &Arc<Self>, tenant: &str) -> Result<App, Problem> {
        if let Some(app) = self.get(tenant) {
            return Ok(app);
        }
        let _turn = self.opening.lock().await;
        if let Some(app) = self.get(tenant) {
            return Ok(app);
        }
        if *self.stopped.borrow() {
            return Err(Problem::stopping());
        }
        if self.list().len() >= LIMITS.tenants {
            return Err(Problem::over_limit("tenants", LIMITS.tenants));
        }
        let name = Name::parse(tenant).ok_or_else(|| Problem::bug("a tenant without a name"))?;
        let (tenants, opened) = (self.clone(), name.clone());
        let opening = tokio::task::spawn_blocking(move || tenants.open(&opened)).await;
        let app = opening.map_err(|_| Problem::bug("opening a tenant panicked"))??;
        tracing::info!(tenant, "a tenant's service is there");
        self.apps.write().unwrap_or_else(PoisonError::into_inner).insert(name, app.clone());
        self.run(app.clone());
        Ok(app)
    }

    fn open(&self, name: &Name) -> Result<App, Problem> {
        let failed = |error: &dyn std::fmt::Display| {
            tracing::error!(tenant = name.as_str(), "not opened: {error}");
            Problem::not_ready("the data folder of this tenant cannot be opened; the service's log says why")
        };
        let folder = self.data.as_ref().map(|data| data.join(FOLDER).join(name.as_str()));
        let recorded = folder.as_ref().map(|folder| folder.join("recordings"));
        if let Some(recorded) = &recorded {
            std::fs::create_dir_all(recorded).map_err(|error| failed(&error))?;
        }
        // Logs of its threads name the tenant.
        let span = tracing::info_span!("tenant", name = name.as_str());
        let service = span.in_scope(|| Service::open(folder.as_deref(), &self.machine));
        let service = service.map_err(|error| failed(&error))?;
        // A tenant can read no files of this machine but its own recordings.
        let recordings = match &recorded {
            Some(folder) => Recordings::Within(ReadableFolder::below(folder).map_err(|error| failed(&error))?),
            None => Recordings::Nowhere,
        };
        let folder = RecordingFolder::at(recorded, &self.space);
        folder.mend_all();
        let first = self.get(DEFAULT_TENANT).ok_or_else(|| Problem::bug("nobody is there without tokens"))?;
        Ok(first.beside(service, (recordings, folder)))
    }

    /// All tenants by name, for operators.
    pub fn all(&self) -> Vec<(Name, App)> {
        let apps = self.apps.read().unwrap_or_else(PoisonError::into_inner);
        apps.iter().map(|(name, app)| (name.clone(), app.clone())).collect()
    }

    /// Whether all tenants accept changes.
    pub fn readiness(&self) -> Result<(), Problem> {
        self.list().iter().try_for_each(|app| app.service.readiness())
    }

    /// Refuses further changes and ends every stream.
    pub fn drain(&self) {
        self.list().iter().for_each(|app| app.service.drain());
    }

    /// Stops all tenants' threads concurrently.
    pub fn stop(&self) {
        self.drain();
        let apps = self.list();
        let Some((one, others)) = apps.split_first() else { return };
        thread::scope(|scope| {
            for app in others {
                scope.spawn(|| app.service.stop());
            }
            one.service.stop();
        });
    }
}

impl FromRequestParts<Arc<Tenants>> for App {
    type Rejection = Problem;

    /// The app of the sender's tenant; without a token, the default tenant's.
    async fn from_request_parts(parts: &mut Parts, tenants: &Arc<Tenants>) -> Result<App, Problem> {
        let tenant = match parts.extensions.get::<Visitor>() {
            Some(Visitor::Known(owner, _)) => owner.tenant(),
            _ => DEFAULT_TENANT,
        };
        let stream = tenants.stream.upgrade().ok_or_else(Problem::stopping)?;
        tenants.app(tenant).await?.of_request(stream)
    }
}
