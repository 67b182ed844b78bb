//! `App`: what a request of one tenant gets to see, and what it has to share with others.

use std::sync::Arc;

use tokio::sync::{Semaphore, mpsc};

use crate::access::Recordings;
use crate::limits::LIMITS;
use crate::problem::Problem;
use crate::recording::RecordingFolder;
use crate::room::{RoomTaken, SharedRoom};
use crate::service::Service;
use crate::streams::pushed::FrameRoom;

/// What every handler gets, of the tenant whose token the request came with.
#[derive(Clone)]
pub struct App {
    /// Everything of the tenant that runs.
    pub service: Arc<Service>,
    /// Held by every stream.
    pub stream: StreamHold,
    /// Places for those whose recordings are being opened.
    pub openings: SharedRoom,
    /// For pushed frames.
    pub frames: Arc<FrameRoom>,
    /// For single images.
    pub images: Arc<ImagePlaces>,
    /// Places for connections.
    pub sockets: Arc<Semaphore>,
    /// For requests, streams among them.
    pub requests: SharedRoom,
    /// Which may be named.
    pub recordings: Recordings,
    /// Where sessions are recorded.
    pub folder: RecordingFolder,
    /// Places for those who read recordings.
    pub downloads: SharedRoom,
    /// Room for pictures that viewers have not taken yet, bytes.
    pub pictures: SharedRoom,
}

/// Kept for as long as there is somebody to answer.
#[derive(Clone, Default)]
pub struct StreamHold {
    /// The service has stopped when all are dropped.
    _service: Option<mpsc::Sender<()>>,
    /// A request's, which is one of its tenant's.
    _place: Option<Arc<RoomTaken>>,
}

/// Places for single images.
pub struct ImagePlaces {
    /// Fitted, or waiting for it.
    pub admitted: SharedRoom,
    /// Fitted.
    pub fitting: SharedRoom,
}

impl App {
    /// Of the tenant whose the machine is where there are no others.
    pub fn new(
        service: Arc<Service>,
        sockets: Arc<Semaphore>,
        (recordings, folder): (Recordings, RecordingFolder),
    ) -> App {
        let images =
            ImagePlaces { admitted: SharedRoom::new(LIMITS.images), fitting: SharedRoom::new(LIMITS.image_fits) };
        App {
            service,
            stream: StreamHold::default(),
            openings: SharedRoom::new(LIMITS.openings),
            frames: Arc::default(),
            images: Arc::new(images),
            sockets,
            requests: SharedRoom::new(LIMITS.sockets),
            recordings,
            folder,
            downloads: SharedRoom::new(LIMITS.downloads),
            pictures: SharedRoom::new(LIMITS.picture_bytes),
        }
    }

    /// Of another tenant of the same machine.
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

    /// For what the service waits for when it stops.
    pub fn held(&self, service: mpsc::Sender<()>) -> App {
        App { stream: StreamHold { _service: Some(service), _place: None }, ..self.clone() }
    }

    /// For one request, which is one of its tenant's until it is answered.
    ///
    /// # Errors
    /// 429 where the tenant has too many.
    pub fn of_request(&self, service: mpsc::Sender<()>) -> Result<App, Problem> {
        let place = self.requests.try_take(1);
        let over = || Problem::over_limit("requests of one tenant at a time", self.requests.most());
        let place = Some(Arc::new(place.ok_or_else(over)?));
        Ok(App { stream: StreamHold { _service: Some(service), _place: place }, ..self.clone() })
    }
}
