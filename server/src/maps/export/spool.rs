//! A file without a name that is written once and read once.

use crate::error::{ApiError, ErrorCode};
use bytes::{Bytes, BytesMut};
use futures_util::Stream;
use std::io::{self, SeekFrom};
use std::path::PathBuf;
use tokio::fs::File;
use tokio::io::{AsyncReadExt, AsyncSeekExt, AsyncWriteExt};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;

/// Bytes written or read at a time.
const CHUNK_BYTES: usize = 64 << 10;

/// See the module's documentation. The system takes the file away when it is dropped, and when the process
/// ends.
pub(super) struct Spool {
    file: File,
    buffer: Vec<u8>,
    n_bytes: u64,
}

impl Spool {
    /// An empty file in a folder.
    pub async fn new(folder: PathBuf) -> Result<Self, ApiError> {
        let made = tokio::task::spawn_blocking(move || tempfile::tempfile_in(folder)).await;
        let file = made.map_err(ApiError::internal)?.map_err(failed)?;
        Ok(Self { file: File::from_std(file), buffer: Vec::new(), n_bytes: 0 })
    }

    /// Appends text.
    pub async fn write(&mut self, text: &str) -> Result<(), ApiError> {
        self.write_bytes(text.as_bytes()).await
    }

    /// Appends bytes.
    pub async fn write_bytes(&mut self, bytes: &[u8]) -> Result<(), ApiError> {
        self.buffer.extend_from_slice(bytes);
        self.n_bytes += bytes.len() as u64;
        if self.buffer.len() >= CHUNK_BYTES { self.flush().await } else { Ok(()) }
    }

    async fn flush(&mut self) -> Result<(), ApiError> {
        self.file.write_all(&self.buffer).await.map_err(failed)?;
        self.buffer.clear();
        Ok(())
    }

    /// How much was written.
    pub fn n_bytes(&self) -> u64 {
        self.n_bytes
    }

    /// What was written, from its beginning, read as it is taken.
    pub async fn into_chunks(mut self) -> Result<impl Stream<Item = io::Result<Bytes>> + use<>, ApiError> {
        self.flush().await?;
        self.file.flush().await.map_err(failed)?;
        self.file.seek(SeekFrom::Start(0)).await.map_err(failed)?;
        // One chunk is read ahead; then the reader waits for the client.
        let (sender, chunks) = mpsc::channel(1);
        tokio::spawn(send(self.file, sender));
        Ok(ReceiverStream::new(chunks))
    }
}

async fn send(mut file: File, chunks: mpsc::Sender<io::Result<Bytes>>) {
    loop {
        let mut chunk = BytesMut::with_capacity(CHUNK_BYTES);
        let read = file.read_buf(&mut chunk).await;
        let is_last = !matches!(read, Ok(n) if n > 0);
        let message = match read {
            Ok(0) => return,
            Ok(_) => Ok(chunk.freeze()),
            Err(error) => Err(error),
        };
        if chunks.send(message).await.is_err() || is_last {
            return;
        }
    }
}

fn failed(error: io::Error) -> ApiError {
    if error.kind() == io::ErrorKind::StorageFull {
        return ApiError::new(ErrorCode::StorageFull, "there is no room on the disk to prepare the file");
    }
    ApiError::internal(error)
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures_util::TryStreamExt;

    async fn read(spool: Spool) -> Vec<u8> {
        let chunks: Vec<Bytes> = spool.into_chunks().await.unwrap().try_collect().await.unwrap();
        chunks.concat()
    }

    #[tokio::test]
    async fn what_is_written_is_read_and_no_file_is_left() {
        let folder = tempfile::tempdir().unwrap();
        let mut spool = Spool::new(folder.path().to_owned()).await.unwrap();
        let mut expected = String::new();
        for line in 0..40_000 {
            let text = format!("line {line}\n");
            spool.write(&text).await.unwrap();
            expected.push_str(&text);
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        assert_eq!(spool.n_bytes(), expected.len() as u64);
        assert_eq!(read(spool).await, expected.as_bytes());
        let empty = Spool::new(folder.path().to_owned()).await.unwrap();
        assert!(read(empty).await.is_empty());
    }
}
