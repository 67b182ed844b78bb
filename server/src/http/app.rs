//! `App`: the state that handlers of one tenant share.

use std::sync::Arc;

use tokio::sync::{Semaphore, mpsc};

use crate::access::Recordings;
use crate::http::streams::pushed::FrameRoom;
use crate::limits::LIMITS;
use crate::net::quota::{QuotaPermit, SharedQuota};
use crate::problem::Problem;
use crate::recording::RecordingFolder;
use crate::service::Service;

/// The state of every handler, of the tenant whose token the request carries.
#[derive(Clone)]
pub struct App {
    /// The tenant's service.
    pub service: Arc<Service>,
    /// Held by every stream: delays shutdown.
    pub stream: StreamHold,
    /// Permits to open recordings.
    pub openings: SharedQuota,
    /// Bytes of pushed frames in flight.
    pub frames: Arc<FrameRoom>,
    /// Permits to fit single images.
    pub images: Arc<ImagePlaces>,
    /// Permits for connections.
    pub sockets: Arc<Semaphore>,
    /// Permits for requests, including streams.
    pub requests: SharedQuota,
    /// Recordings that documents may name.
    pub recordings: Recordings,
    /// The folder that sessions are recorded to.
    pub folder: RecordingFolder,
    /// Permits for downloads of recordings.
    pub downloads: SharedQuota,
    /// Bytes of pictures that viewers have not received yet.
    pub pictures: SharedQuota,
}

/// Held until a request is answered or its stream ends.
#[derive(Clone, Default)]
pub struct StreamHold {
    /// Shutdown waits until all of these are dropped.
    _service: Option<mpsc::Sender<()>>,
    /// The request's permit, of its tenant's quota.
    _place: Option<Arc<QuotaPermit>>,
}

/// Permits for single images.
pub struct ImagePlaces {
    /// Images that are fitted or wait for it.
    pub admitted: SharedQuota,
    /// Images that are fitted.
    pub fitting: SharedQuota,
}

impl App {
    /// The state of a sole tenant, which may use the whole machine.
    pub fn new(
        service: Arc<Service>,
        sockets: Arc<Semaphore>,
        (recordings, folder): (Recordings, RecordingFolder),
    ) -> App {
        let images =
            ImagePlaces { admitted: SharedQuota::new(LIMITS.images), fitting: SharedQuota::new(LIMITS.image_fits) };
        App {
            service,
            stream: StreamHold::default(),
            openings: SharedQuota::new(LIMITS.openings),
            frames: Arc::default(),
            images: Arc::new(images),
            sockets,
            requests: SharedQuota::new(LIMITS.sockets),
            recordings,
            folder,
            downloads: SharedQuota::new(LIMITS.downloads),
            pictures: SharedQuota::new(LIMITS.picture_bytes),
        }
    }

    /// The state of another tenant of the same machine.
    pub fn beside(&self, service: Arc<Service>, (recordings, folder): (Recordings, RecordingFolder)) -> App {
        let ImagePlaces { admitted, fitting } = &*self.images;
        App {
            service,
            stream: StreamHold::default(),
            openings: self.openings.part(),
            frames: Arc::new(self.frames.part()),
            images: Arc::new(ImagePlaces { admitted: admitted.part(), fitting: fitting.part() }),
            sockets: self.sockets.clone(),
            requests: self.requests.part(),
            recordings,
            folder,
            downloads: self.downloads.part(),
            pictures: self.pictures.part(),
        }
    }

    /// A clone that shutdown waits for.
    pub fn held(&self, service: mpsc::Sender<()>) -> App {
        App { stream: StreamHold { _service: Some(service), _place: None }, ..self.clone() }
    }

    /// A clone for one request; takes a permit of the tenant's requests until it is dropped.
    ///
    /// # Errors
    /// 429 at the tenant's limit of requests.
    pub fn of_request(&self, service: mpsc::Sender<()>) -> Result<App, Problem> {
        let place = self.requests.try_take(1);
        let over = || Problem::over_limit("requests of one tenant at a time", self.requests.most());
        let place = Some(Arc::new(place.ok_or_else(over)?));
        Ok(App { stream: StreamHold { _service: Some(service), _place: place }, ..self.clone() })
    }
}
