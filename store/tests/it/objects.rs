//! Images in an object store: a folder, and, where `READERS_PYTHON` names a Python that has moto, one of S3's
//! kind.

use crate::world::*;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use store::{
    Collected, Copied, KeyframeImage, ObjectOptions, Objects, Store, StoreError, StoreOptions, Verified,
};
use tempfile::TempDir;

fn open(url: &str) -> Objects {
    Objects::open(url, ObjectOptions { timeout: Duration::from_secs(3) }).unwrap()
}

struct Place {
    folder: TempDir,
    url: String,
}

impl Place {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let url = format!("file://{}/objects", folder.path().display());
        Self { folder, url }
    }

    fn database(&self) -> PathBuf {
        self.folder.path().join("maps.db")
    }

    async fn store(&self) -> Store {
        let store = Store::open(self.database(), StoreOptions::default()).await.unwrap();
        store.with_objects(Some(open(&self.url)))
    }

    /// The files of the objects.
    fn objects(&self) -> Vec<PathBuf> {
        let folder = self.folder.path().join("objects");
        let of = |folder: &Path| -> Vec<PathBuf> {
            std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect()
        };
        of(&folder).iter().flat_map(|folder| of(folder)).collect()
    }

    /// Makes all objects older than they are.
    fn age(&self, hours: u64) {
        for path in self.objects() {
            let name = path.file_name().unwrap().to_str().unwrap();
            let (hash, written) = name.split_once('-').unwrap();
            let written = u64::from_str_radix(written, 16).unwrap() - hours;
            std::fs::rename(&path, path.with_file_name(format!("{hash}-{written:x}"))).unwrap();
        }
    }
}

/// A session whose first two keyframes have images.
async fn session_with_images(store: &Store, id: &str) -> [KeyframeImage; 2] {
    let world = parts(1, SMALL);
    store.create_session(&new_session(id)).await.unwrap();
    let image = |idx: usize| KeyframeImage {
        keyframe: world.keyframes[idx].id,
        media_type: "image/png".into(),
        bytes: format!("image {idx}").into_bytes(),
    };
    let images = [image(0), image(1)];
    store.save_update(id, &first_update(&world), TRACKED, &images).await.unwrap();
    images
}

#[tokio::test]
async fn images_in_an_object_store_are_the_same_as_in_the_database() {
    let (place, inline) = (Place::new(), Place::new());
    let (store, without) = (place.store().await, inline.store().await.with_objects(None));
    let images = session_with_images(&store, "s").await;
    session_with_images(&without, "s").await;
    for image in &images {
        let found = store.keyframe_image("s", image.keyframe).await.unwrap().unwrap();
        assert_eq!((found.media_type.as_str(), &found.bytes), ("image/png", &image.bytes));
    }
    assert_eq!(place.objects().len(), 2);
    assert_eq!((store.n_image_objects().await.unwrap(), without.n_image_objects().await.unwrap()), (2, 0));
    assert_eq!(store.digest("s").await.unwrap(), without.digest("s").await.unwrap());
    let sizes = [&store, &without].map(|store| store.stored_bytes_of(""));
    let [here, there] = futures(sizes).await;
    assert_eq!(here, there, "quotas count them all the same");
    assert_eq!(store.check().await.unwrap(), []);

    // Without the object store the map is there, and its images are not.
    let away = store.clone().with_objects(None);
    let refused = away.keyframe_image("s", images[0].keyframe).await;
    assert!(matches!(refused, Err(StoreError::Objects(_))), "{refused:?}");
}

async fn futures<F: Future<Output = Result<u64, StoreError>>>([a, b]: [F; 2]) -> [u64; 2] {
    [a.await.unwrap(), b.await.unwrap()]
}

#[tokio::test]
async fn only_old_objects_that_nothing_names_are_removed() {
    let place = Place::new();
    let store = place.store().await;
    session_with_images(&store, "kept").await;
    let before = place.objects();
    // What another process uploads and is about to name.
    let stray = before[0].with_file_name(
        before[0]
            .file_name()
            .unwrap()
            .to_str()
            .unwrap()
            .replace(&before[0].file_name().unwrap().to_str().unwrap()[..8], "00000000"),
    );
    std::fs::write(&stray, b"on its way").unwrap();
    let none = |n_objects| Collected { n_objects, ..Collected::default() };
    assert_eq!(store.collect_orphans(2).await.unwrap(), none(2), "a name that is not ours is not looked at");
    std::fs::remove_file(&stray).unwrap();

    store.delete_session("kept").await.unwrap();
    assert_eq!(store.collect_orphans(2).await.unwrap(), none(2), "they are too new");
    place.age(3);
    // The same images again, under new names.
    session_with_images(&store.clone().with_objects(Some(open(&place.url))), "again").await;
    let collected = store.collect_orphans(2).await.unwrap();
    assert_eq!(collected, Collected { n_objects: 4, n_removed: 2, n_removed_bytes: 14 });
    assert_eq!(place.objects().len(), 2);
    assert_eq!(store.check_objects().await.unwrap(), []);
}

#[tokio::test]
async fn missing_and_changed_objects_are_found() {
    let place = Place::new();
    let store = place.store().await;
    let images = session_with_images(&store, "s").await;
    store.close().await.unwrap();
    let objects = place.objects();
    std::fs::remove_file(&objects[0]).unwrap();
    std::fs::write(&objects[1], b"image").unwrap();
    let verified = Store::verify_with(&place.database(), Some(open(&place.url))).await.unwrap();
    let Verified { findings, n_image_objects, .. } = &verified;
    assert_eq!((findings.len(), *n_image_objects), (2, 2), "{findings:?}");
    let said: Vec<String> = findings.iter().map(ToString::to_string).collect();
    assert!(said.iter().any(|line| line.contains("is missing")), "{said:?}");
    assert!(said.iter().any(|line| line.contains("has 5 bytes")), "{said:?}");
    let store = place.store().await;
    for image in &images {
        let found = store.keyframe_image("s", image.keyframe).await;
        assert!(matches!(found, Err(StoreError::Corrupt(_))), "{found:?}");
    }
}

#[tokio::test]
async fn a_copy_brings_images_to_an_object_store_and_finds_them_there() {
    let (from, to, third) = (Place::new(), Place::new(), Place::new());
    let source = from.store().await.with_objects(None);
    let images = session_with_images(&source, "s").await;
    let copy = to.store().await;
    assert_eq!(copy.copy_session(&source, "s").await.unwrap(), Copied::Whole);
    assert_eq!((copy.n_image_objects().await.unwrap(), to.objects().len()), (2, 2));
    let found = copy.keyframe_image("s", images[1].keyframe).await.unwrap().unwrap();
    assert_eq!(found.bytes, images[1].bytes);
    assert_eq!(copy.copy_session(&source, "s").await.unwrap(), Copied::Before);
    // Into a database whose object store does not have them.
    let refused = third.store().await.copy_session(&copy, "s").await;
    assert!(matches!(refused, Err(StoreError::Corrupt(_))), "{refused:?}");
}

#[tokio::test]
async fn nothing_is_saved_that_names_what_could_not_be_uploaded() {
    let place = Place::new();
    let store = place.store().await;
    let world = parts(1, SMALL);
    store.create_session(&new_session("s")).await.unwrap();
    let objects = place.folder.path().join("objects");
    std::fs::remove_dir(&objects).unwrap();
    std::fs::write(&objects, b"in the way").unwrap();
    let image =
        KeyframeImage { keyframe: world.keyframes[0].id, media_type: "image/png".into(), bytes: vec![7; 9] };
    let images = [image];
    let refused = store.save_update("s", &first_update(&world), TRACKED, &images).await;
    assert!(matches!(refused, Err(StoreError::Objects(_))), "{refused:?}");
    assert_eq!(store.get_session("s").await.unwrap().counts.n_keyframes, 0);
    std::fs::remove_file(&objects).unwrap();
    store.save_update("s", &first_update(&world), TRACKED, &images).await.unwrap();
    assert_eq!(store.check_objects().await.unwrap(), []);
}

/// A server of S3's kind, and what its clients find in their environment.
struct Moto(Child);

impl Drop for Moto {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Moto {
    fn start(python: &str, port: u16) -> Self {
        let mut command = Command::new(python);
        command.args(["-m", "moto.server", "-H", "127.0.0.1", "-p", &port.to_string()]);
        let child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("moto starts");
        let begun = Instant::now();
        while std::net::TcpStream::connect(("127.0.0.1", port)).is_err() {
            assert!(begun.elapsed() < Duration::from_secs(60), "moto does not listen");
            std::thread::sleep(Duration::from_millis(50));
        }
        Self(child)
    }
}

#[tokio::test]
#[ignore = "needs Python with moto"]
async fn s3_keeps_images_and_is_away_for_a_while() {
    let python = std::env::var("READERS_PYTHON").expect("a Python with cli/tests/requirements.txt");
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    // SAFETY: each test of this run is a process of its own, and nothing else reads the environment yet.
    unsafe {
        std::env::set_var("AWS_ENDPOINT_URL", format!("http://127.0.0.1:{port}"));
        std::env::set_var("AWS_ACCESS_KEY_ID", "testing");
        std::env::set_var("AWS_SECRET_ACCESS_KEY", "testing");
        std::env::set_var("AWS_REGION", "us-east-1");
    }
    let moto = Moto::start(&python, port);
    let make_bucket = "import boto3, os; boto3.client('s3', endpoint_url=os.environ['AWS_ENDPOINT_URL'], \
                       region_name='us-east-1').create_bucket(Bucket='maps')";
    assert!(Command::new(&python).args(["-c", make_bucket]).status().unwrap().success());
    let place = Place::new();
    let store = place.store().await.with_objects(Some(open("s3://maps/images/of/this")));
    let images = session_with_images(&store, "s").await;
    for image in &images {
        let found = store.keyframe_image("s", image.keyframe).await.unwrap().unwrap();
        assert_eq!(found.bytes, image.bytes);
    }
    assert_eq!(store.check_objects().await.unwrap(), []);
    store.create_session(&new_session("t")).await.unwrap();
    store.delete_session("s").await.unwrap();
    assert_eq!(store.collect_orphans(2).await.unwrap(), Collected { n_objects: 2, ..Collected::default() });

    drop(moto);
    let world = parts(2, SMALL);
    let image =
        KeyframeImage { keyframe: world.keyframes[0].id, media_type: "image/png".into(), bytes: vec![7; 9] };
    let (images, begun) = ([image], Instant::now());
    let refused = store.save_update("t", &first_update(&world), TRACKED, &images).await;
    assert!(matches!(refused, Err(StoreError::Objects(_))), "{refused:?}");
    eprintln!("an upload was given up after {:.1?}: {}", begun.elapsed(), refused.unwrap_err());
    assert!(begun.elapsed() < Duration::from_secs(5), "it waits for longer than it may");
    let _moto = Moto::start(&python, port);
    assert!(Command::new(&python).args(["-c", make_bucket]).status().unwrap().success());
    store.save_update("t", &first_update(&world), TRACKED, &images).await.unwrap();
    let found = store.keyframe_image("t", images[0].keyframe).await.unwrap().unwrap();
    assert_eq!(found.bytes, images[0].bytes);
}
