// Access to the webcam.

/** A stream of the camera; throws where there is none or it is not allowed. */
export async function openWebcam() {
  // Browsers offer no webcams to pages without TLS.
  if (!navigator.mediaDevices) {
    throw new Error("browsers allow it only on pages over HTTPS or on localhost.");
  }
  return navigator.mediaDevices.getUserMedia(
    { video: { width: 640, height: 480, facingMode: "environment" } });
}
