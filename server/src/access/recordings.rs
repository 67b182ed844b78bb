//! Which recordings may be named: all that this machine has, those below one folder, or none.

use isophote_capture::ReadableFolder;

use crate::problem::Problem;

/// What paths in documents may reach.
#[derive(Clone, Debug)]
pub enum Recordings {
    /// Whatever the reach says.
    Within(ReadableFolder),
    /// None: those who come with tokens are not those who may read this machine's files.
    Nowhere,
}

impl Recordings {
    /// Where they may be; 422 at the path of a document where they may be nowhere.
    pub fn reach(&self, prefix: &str) -> Result<ReadableFolder, Problem> {
        let message = "this service reads no recordings but its own, by the names that GET /v1/recordings lists; started with \
                       --recordings DIR it reads those below that folder, too";
        match self {
            Recordings::Within(reach) => Ok(reach.clone()),
            Recordings::Nowhere => Err(Problem::wrong_key("wrong-source", &format!("{prefix}path"), message)),
        }
    }
}
