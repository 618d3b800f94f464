//! An object store: one of S3's kind, or a folder.

use crate::StoreError;
use bytes::Bytes;
use futures_util::stream::{BoxStream, StreamExt};
use object_store::aws::AmazonS3Builder;
use object_store::local::LocalFileSystem;
use object_store::path::Path;
use object_store::prefix::PrefixStore;
use object_store::{BackoffConfig, ClientOptions, ObjectStore, RetryConfig};
use sha2::{Digest, Sha256};
use std::collections::BTreeSet;
use std::fmt;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Seconds in the unit of time that objects' names are written in.
const HOUR_S: u64 = 3600;

/// Names of objects that were uploaded lately are kept, so that a commit that is tried again, as while the
/// database is away, uploads nothing twice. As many as a session makes in minutes.
const MAX_REMEMBERED: usize = 4096;

/// How an object store is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ObjectOptions {
    /// How long one upload or download may take, with what is tried again. Default 20 s.
    pub timeout: Duration,
}

impl Default for ObjectOptions {
    fn default() -> Self {
        Self { timeout: Duration::from_secs(20) }
    }
}

/// See the module's documentation. Clones are the same.
#[derive(Clone)]
pub struct Objects(Arc<Inner>);

struct Inner {
    store: Box<dyn ObjectStore>,
    /// Of a folder.
    folder: Option<PathBuf>,
    /// What is said of it in errors; without credentials, which stand nowhere in it.
    url: String,
    timeout: Duration,
    remembered: Mutex<BTreeSet<String>>,
}

impl fmt::Debug for Objects {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Objects").field(&self.0.url).finish()
    }
}

impl Objects {
    /// The store of a URL: `s3://bucket/prefix`, with credentials, region and endpoint from the environment
    /// as Amazon's programs have them (`AWS_ACCESS_KEY_ID`, `AWS_ENDPOINT_URL`, …), or `file:///folder`,
    /// which is made if it is not there. Nothing is asked of it yet.
    ///
    /// # Errors
    /// [`StoreError::Address`] if it is neither, and [`StoreError::Objects`] if it cannot be used.
    pub fn open(url: &str, options: ObjectOptions) -> Result<Self, StoreError> {
        let (store, folder): (Box<dyn ObjectStore>, _) = if let Some(folder) = url.strip_prefix("file://") {
            let folder = PathBuf::from(folder);
            if !folder.is_absolute() {
                return Err(StoreError::Address(format!("{url:?}: file:///FOLDER expected")));
            }
            std::fs::create_dir_all(&folder).map_err(|error| unusable(url, &error))?;
            let store = LocalFileSystem::new_with_prefix(&folder).map_err(|error| unusable(url, &error))?;
            (Box::new(store), Some(folder))
        } else if let Some(place) = url.strip_prefix("s3://") {
            let (bucket, prefix) = place.split_once('/').unwrap_or((place, ""));
            let prefix = Path::parse(prefix.trim_end_matches('/'));
            let prefix = prefix.map_err(|error| StoreError::Address(format!("{url:?}: {error}")))?;
            let client = ClientOptions::new().with_timeout(options.timeout).with_allow_http(allows_http());
            let backoff = BackoffConfig { max_backoff: options.timeout / 4, ..BackoffConfig::default() };
            let retry = RetryConfig { backoff, max_retries: 3, retry_timeout: options.timeout };
            let s3 = AmazonS3Builder::from_env().with_bucket_name(bucket);
            let s3 = s3.with_client_options(client).with_retry(retry).build();
            (Box::new(PrefixStore::new(s3.map_err(|error| unusable(url, &error))?, prefix)), None)
        } else {
            return Err(StoreError::Address(format!(
                "{url:?}: s3://BUCKET/PREFIX or file:///FOLDER expected"
            )));
        };
        let (timeout, remembered) = (options.timeout, Mutex::default());
        Ok(Self(Arc::new(Inner { store, folder, url: url.to_owned(), timeout, remembered })))
    }

    /// Stores bytes; the object's name. They are there, and outlive the machine, when this returns.
    pub(super) async fn put(&self, bytes: &[u8]) -> Result<String, StoreError> {
        let name = name_of(&hash_of(bytes), now_hours());
        if self.remembered().contains(&name) {
            return Ok(name);
        }
        let path = path_of(&name)?;
        let payload = Bytes::copy_from_slice(bytes);
        self.limited(self.0.store.put(&path, payload.into())).await?;
        if let Some(folder) = self.0.folder.clone() {
            let file = folder.join(&name);
            let synced = tokio::task::spawn_blocking(move || sync(&file)).await;
            let synced = synced.unwrap_or_else(|error| Err(std::io::Error::other(error)));
            synced.map_err(|error| unusable(&self.0.url, &error))?;
        }
        let mut remembered = self.remembered();
        if remembered.len() >= MAX_REMEMBERED {
            remembered.clear();
        }
        remembered.insert(name.clone());
        Ok(name)
    }

    /// The bytes of an object, which are those that were stored.
    pub(super) async fn get(&self, name: &str) -> Result<Vec<u8>, StoreError> {
        let path = path_of(name)?;
        let bytes = self.limited(async { self.0.store.get(&path).await?.bytes().await }).await?;
        if hash_of(&bytes) != hash_in(name)? {
            return Err(StoreError::Corrupt(format!("the object {name} is not what was stored")));
        }
        Ok(bytes.to_vec())
    }

    /// Fails if there is no such object.
    pub(super) async fn require(&self, name: &str) -> Result<(), StoreError> {
        let path = path_of(name)?;
        self.limited(self.0.store.head(&path)).await.map(drop)
    }

    /// The names of all objects, with how many bytes they have.
    pub(super) fn list(&self) -> BoxStream<'_, Result<(String, u64), StoreError>> {
        let listed = self.0.store.list(None);
        let entry = |listed: object_store::Result<object_store::ObjectMeta>| {
            let listed = listed.map_err(|error| unusable(&self.0.url, &error))?;
            Ok((listed.location.to_string(), listed.size))
        };
        listed.map(entry).boxed()
    }

    /// Removes an object.
    pub(super) async fn remove(&self, name: &str) -> Result<(), StoreError> {
        let path = path_of(name)?;
        match tokio::time::timeout(self.0.timeout, self.0.store.delete(&path)).await {
            Ok(Ok(()) | Err(object_store::Error::NotFound { .. })) => Ok(()),
            Ok(Err(error)) => Err(unusable(&self.0.url, &error)),
            Err(_elapsed) => Err(unusable(&self.0.url, &"it does not answer")),
        }
    }

    async fn limited<T>(&self, work: impl Future<Output = object_store::Result<T>>) -> Result<T, StoreError> {
        match tokio::time::timeout(self.0.timeout, work).await {
            Ok(Ok(done)) => Ok(done),
            Ok(Err(object_store::Error::NotFound { path, .. })) => {
                Err(StoreError::Corrupt(format!("the object {path} is missing in {}", self.0.url)))
            }
            Ok(Err(error)) => Err(unusable(&self.0.url, &error)),
            Err(_elapsed) => Err(unusable(&self.0.url, &format!("no answer within {:?}", self.0.timeout))),
        }
    }

    fn remembered(&self) -> std::sync::MutexGuard<'_, BTreeSet<String>> {
        // No code that can panic runs while it is locked.
        self.0.remembered.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn unusable(url: &str, cause: &dyn fmt::Display) -> StoreError {
    StoreError::Objects(format!("{url}: {cause}"))
}

/// Whether the endpoint that the environment names is without encryption, as one beside the server may be.
fn allows_http() -> bool {
    ["AWS_ENDPOINT_URL", "AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT"]
        .iter()
        .filter_map(|name| std::env::var(name).ok())
        .any(|endpoint| endpoint.starts_with("http://"))
}

/// Brings a file and its name to the disk.
fn sync(file: &std::path::Path) -> std::io::Result<()> {
    std::fs::File::open(file)?.sync_all()?;
    match file.parent() {
        Some(folder) => std::fs::File::open(folder)?.sync_all(),
        None => Ok(()),
    }
}

fn path_of(name: &str) -> Result<Path, StoreError> {
    Path::parse(name).map_err(|_| StoreError::Corrupt(format!("{name:?} is no name of an object")))
}

/// SHA-256 of an image.
pub fn hash_of(bytes: &[u8]) -> [u8; 32] {
    Sha256::digest(bytes).into()
}

/// Hours since 1970.
pub fn now_hours() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs() / HOUR_S)
}

/// The name of an object: the hash of what it holds, in folders by its beginning, and the hour in which it
/// was written.
///
/// With the hour, what nothing names for a day is never written again under the same name, so that removing
/// it cannot meet who is about to name it.
fn name_of(hash: &[u8; 32], hours: u64) -> String {
    let hash: String = hash.iter().map(|byte| format!("{byte:02x}")).collect();
    format!("{}/{hash}-{hours:x}", &hash[..2])
}

/// The hash in an object's name.
pub fn hash_in(name: &str) -> Result<[u8; 32], StoreError> {
    parts_of(name)
        .map(|(hash, _)| hash)
        .ok_or_else(|| StoreError::Corrupt(format!("{name:?} is no name of an object")))
}

/// When an object was written, in hours since 1970; `None` of what is not ours.
pub fn hours_in(name: &str) -> Option<u64> {
    parts_of(name).map(|(_, hours)| hours)
}

fn parts_of(name: &str) -> Option<([u8; 32], u64)> {
    let (text, hours) = name.split_once('/')?.1.split_once('-')?;
    let mut hash = [0; 32];
    if text.len() != 2 * hash.len() || !text.is_ascii() {
        return None;
    }
    for (idx, byte) in hash.iter_mut().enumerate() {
        *byte = u8::from_str_radix(&text[2 * idx..2 * idx + 2], 16).ok()?;
    }
    let hours = u64::from_str_radix(hours, 16).ok()?;
    (name_of(&hash, hours) == name).then_some((hash, hours))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_say_what_and_when() {
        let hash = hash_of(b"image");
        let name = name_of(&hash, 499_000);
        assert_eq!((hash_in(&name).unwrap(), hours_in(&name)), (hash, Some(499_000)));
        for other in
            ["", "a", "ab/cd-1", "../etc-1", &name[..60], &name.replace('/', "x"), &format!("0{name}")]
        {
            assert!(hash_in(other).is_err() && hours_in(other).is_none(), "{other}");
        }
    }

    #[tokio::test]
    async fn what_was_changed_or_lost_is_noticed() {
        let folder = tempfile::tempdir().unwrap();
        let url = format!("file://{}", folder.path().display());
        let objects = Objects::open(&url, ObjectOptions::default()).unwrap();
        let name = objects.put(b"image").await.unwrap();
        assert_eq!(objects.get(&name).await.unwrap(), b"image");
        std::fs::write(folder.path().join(&name), b"imagf").unwrap();
        assert!(matches!(objects.get(&name).await, Err(StoreError::Corrupt(_))));
        objects.remove(&name).await.unwrap();
        objects.remove(&name).await.unwrap();
        assert!(matches!(objects.get(&name).await, Err(StoreError::Corrupt(_))));
        for url in ["http://h/x", "file://relative", "bucket"] {
            assert!(
                matches!(Objects::open(url, ObjectOptions::default()), Err(StoreError::Address(_))),
                "{url}"
            );
        }
    }
}
