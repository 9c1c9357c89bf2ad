//! A wish to move by hand, as a client writes it: refused at a named place in few words, or an order; and
//! what is written of it again means the same.

use keys::jog::{JogRequest, REQUEST_BYTES_MAX};

/// See the module.
pub fn check(data: &[u8]) {
    if data.len() > REQUEST_BYTES_MAX {
        return;
    }
    let Ok(request) = serde_json::from_slice::<JogRequest>(data) else {
        return;
    };
    let text = serde_json::to_vec(&request).expect("it was JSON");
    let again: JogRequest = serde_json::from_slice(&text).expect("it is JSON");
    assert_eq!(again, request);
    assert_eq!(again.order(), request.order());
    if let Err(error) = request.order() {
        assert!(!error.message.is_empty() && error.to_string().len() < 200);
    }
}

/// Each verb once, and some that are wrong.
pub fn seeds() -> Vec<Vec<u8>> {
    [
        r#"{"axis":0,"run":"forward","speed_hz":800,"accel":2000}"#,
        r#"{"axis":1,"by":-10,"speed_hz":500,"accel":2000,"jerk":100000}"#,
        r#"{"axis":1,"to":9223372036854775807,"speed_hz":1000000,"accel":4294967295}"#,
        r#"{"axis":0,"accelerate":-2000,"lease_ms":50}"#,
        r#"{"axis":0,"coast":true,"lease_ms":10000}"#,
        r#"{"axis":0,"stop":true}"#,
        r#"{"renew":7}"#,
        r#"{"stop":true,"renew":7}"#,
        r#"{"axis":255,"by":0}"#,
    ]
    .map(|text| text.as_bytes().to_vec())
    .to_vec()
}
