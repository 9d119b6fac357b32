//! Kinds of errors of an object store.

use object_store::Error;

/// Whether there is no bucket of that name.
pub(super) fn is_missing_bucket(error: &Error) -> bool {
    let text = error.to_string();
    ["NoSuchBucket", "ContainerNotFound", "bucket does not exist"].iter().any(|code| text.contains(code))
}

/// Whether the connection ended, or timed out, before the answer. The server may have executed the request.
#[cfg(feature = "object-stores")]
pub(super) fn is_unanswered(error: &Error) -> bool {
    use object_store::client::{HttpError, HttpErrorKind};
    let mut cause: Option<&(dyn std::error::Error + 'static)> = Some(error);
    while let Some(this) = cause {
        if let Some(http) = this.downcast_ref::<HttpError>() {
            return matches!(http.kind(), HttpErrorKind::Timeout | HttpErrorKind::Interrupted);
        }
        cause = this.source();
    }
    false
}

#[cfg(not(feature = "object-stores"))]
pub(super) fn is_unanswered(_: &Error) -> bool {
    false
}

/// Whether an answer was truncated.
pub(super) fn is_cut(error: &Error) -> bool {
    matches!(error, Error::Generic { .. }) && error.to_string().contains("response body")
}

/// Whether the store rejects the request, or the identity of the caller.
pub(super) fn is_forbidden(error: &Error, text: &str) -> bool {
    // For a listing, only the text of the error gives the status.
    let is_rejected = ["403 Forbidden", "401 Unauthorized"].iter().any(|status| text.contains(status));
    is_rejected || matches!(error, Error::PermissionDenied { .. } | Error::Unauthenticated { .. })
}

/// Whether there is no object of that name.
pub(super) fn is_missing(error: &Error) -> bool {
    matches!(error, Error::NotFound { .. }) && !is_missing_bucket(error)
}
