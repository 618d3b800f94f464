//! The HTTP interface over a database that has a map, without a socket.

use axum::Router;
use axum::body::Body;
use axum::http::{Method, Request, Response, StatusCode};
use http_body_util::BodyExt;
use serde_json::Value;
use server::{Config, Service, open_store, rest};
use slam::map::{MapParts, PrimitiveId};
use std::path::Path;
use std::sync::Arc;
use store::KeyframeImage;
use tempfile::TempDir;
use testkit::stored::{TRACKED, new_session};
use testkit::world::{SMALL, first_update, structured};
use tower::ServiceExt;

/// The interface over a database that has a map, `s`.
pub struct Api {
    router: Router,
    pub world: MapParts,
    _folder: TempDir,
}

/// Makes a database with a session, `s`, that has this map.
pub async fn store_map(folder: &Path, world: &MapParts, images: &[KeyframeImage]) {
    let store = open_store(&Config::local(folder)).await.unwrap();
    store.create_session(&new_session("s")).await.unwrap();
    store.save_update("s", &first_update(world), TRACKED, images).await.unwrap();
    store.close().await.unwrap();
}

impl Api {
    pub async fn new() -> Self {
        Self::with(structured(7, SMALL), &[]).await
    }

    pub async fn with(world: MapParts, images: &[KeyframeImage]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        store_map(folder.path(), &world, images).await;
        Self::over(folder, world).await
    }

    /// The interface over the database in a folder, which has this map.
    pub async fn over(folder: TempDir, world: MapParts) -> Self {
        let config = Config::local(folder.path());
        let store = open_store(&config).await.unwrap();
        let service = Arc::new(Service::new(Arc::new(config), store).await.unwrap());
        Self { router: rest::router(rest::App::new(service)), world, _folder: folder }
    }

    pub async fn send(
        &self,
        method: Method,
        path: &str,
        content_type: &str,
        body: impl Into<Body>,
    ) -> Response<Body> {
        let request = Request::builder().method(method).uri(path).header("content-type", content_type);
        self.call(request.body(body.into()).unwrap()).await
    }

    pub async fn call(&self, request: Request<Body>) -> Response<Body> {
        self.router.clone().oneshot(request).await.unwrap()
    }

    pub async fn text(&self, path: &str) -> String {
        let path = format!("/v1/sessions/s{path}");
        let response = self.send(Method::GET, &path, "text/plain", Body::empty()).await;
        assert_eq!(response.status(), StatusCode::OK, "{path}");
        String::from_utf8(response.into_body().collect().await.unwrap().to_bytes().to_vec()).unwrap()
    }

    pub async fn json(&self, path: &str) -> Value {
        serde_json::from_str(&self.text(path).await).unwrap()
    }

    pub fn lines_of(&self, primitive: PrimitiveId) -> Vec<u64> {
        let lines = self.world.lines.iter().filter(|line| line.primitive == Some(primitive));
        lines.map(|line| line.id.get()).collect()
    }
}
