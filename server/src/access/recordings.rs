//! Recordings that documents may name: any on this machine, those below one folder, or none.

use isophote_capture::ReadableFolder;

use crate::problem::Problem;

/// The reach of paths in documents.
#[derive(Clone, Debug)]
pub enum Recordings {
    /// Paths within this folder; the default one allows any.
    Within(ReadableFolder),
    /// None: holders of tokens need not be allowed to read this machine's files.
    Nowhere,
}

impl Recordings {
    /// The reach; 422 at the document's path if there is none.
    pub fn reach(&self, prefix: &str) -> Result<ReadableFolder, Problem> {
        let message = "this service reads no recordings but its own, by the names that GET /v1/recordings lists; started with \
                       --recordings DIR it reads those below that folder, too";
        match self {
            Recordings::Within(reach) => Ok(reach.clone()),
            Recordings::Nowhere => Err(Problem::wrong_key("wrong-source", &format!("{prefix}path"), message)),
        }
    }
}
