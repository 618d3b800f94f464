/** The device's camera: its picture, and frames of it as JPEG with the times they were taken. */

import { h } from '../dom';
import type { Shot } from './ledger';

/** What is asked of the camera: enough detail for the map, little enough for a phone's network. */
const WANTED = {
  facingMode: { ideal: 'environment' },
  width: { ideal: 640 },
  height: { ideal: 480 },
  frameRate: { ideal: 30 },
  // As the sensor has it: a picture cut to another shape has another field of view.
  resizeMode: { ideal: 'none' },
} as MediaTrackConstraints;

/** Longer side of the frames sent, pixels, whatever the camera gives. */
const MAX_SIDE = 960;

const JPEG_QUALITY = 0.85;

/** Why there is no camera, and what to do. */
export function cameraProblem(error: unknown): string {
  const name = error instanceof DOMException ? error.name : '';
  if (name === 'NotAllowedError') return 'The camera was not allowed. Allow it in the browser’s settings for this page and start again.';
  if (name === 'NotFoundError' || name === 'OverconstrainedError') return 'This device has no camera that the browser can use.';
  if (name === 'NotReadableError') return 'Another program uses the camera. Close it and start again.';
  return error instanceof Error ? error.message : String(error);
}

/** Size of the frames of a picture of this size. */
export function frameSize(width: number, height: number): [number, number] {
  const shrink = Math.min(1, MAX_SIDE / Math.max(width, height, 1));
  return [Math.round(width * shrink), Math.round(height * shrink)];
}

export class Camera {
  readonly video = h('video', { playsinline: true, muted: true, 'aria-label': 'What the camera sees' });
  readonly #canvas = document.createElement('canvas');
  #isEncoding = false;
  #lastNs = 0n;
  #callback = 0;

  private constructor(private readonly media: MediaStream) {
    this.video.muted = true;
    this.video.srcObject = media;
  }

  /** Opens the rear camera, or what there is, and waits for its first picture. */
  static async open(): Promise<Camera> {
    const camera = new Camera(await navigator.mediaDevices.getUserMedia({ video: WANTED, audio: false }));
    await camera.video.play();
    return camera;
  }

  /** Width and height of the frames. */
  get size(): [number, number] {
    return frameSize(this.video.videoWidth, this.video.videoHeight);
  }

  /** Takes frames whenever `wants` says so; those in between are left out before they cost anything. */
  start(wants: () => boolean, take: (shot: Shot, size: [number, number]) => void): void {
    const next = () => {
      this.#callback = this.video.requestVideoFrameCallback((now, frame) => {
        next();
        if (this.#isEncoding || !wants()) return;
        // When the light fell on the sensor, where the browser knows it.
        void this.#shoot(frame.captureTime ?? now, take);
      });
    };
    next();
  }

  stop(): void {
    this.video.cancelVideoFrameCallback(this.#callback);
    this.media.getTracks().forEach((track) => track.stop());
  }

  async #shoot(atMs: number, take: (shot: Shot, size: [number, number]) => void): Promise<void> {
    const timestampNs = BigInt(Math.round((performance.timeOrigin + atMs) * 1000)) * 1000n;
    if (timestampNs <= this.#lastNs) return;
    const size = this.size;
    [this.#canvas.width, this.#canvas.height] = size;
    this.#canvas.getContext('2d')!.drawImage(this.video, 0, 0, ...size);
    this.#isEncoding = true;
    const image = await new Promise<Blob | null>((resolve) => this.#canvas.toBlob(resolve, 'image/jpeg', JPEG_QUALITY));
    this.#isEncoding = false;
    if (!image) return;
    this.#lastNs = timestampNs;
    take({ timestampNs, image }, size);
  }
}
