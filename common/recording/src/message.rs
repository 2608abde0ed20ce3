//! Encoding of our own messages: their memory layout without trailing zeros.

use bytemuck::{Pod, Zeroable};

/// Encodes a message into `out`, replacing its content. Stale list elements should have been cleared
/// ([`messages::ClearStale`]).
pub fn encode_message<T: Pod>(message: &T, out: &mut Vec<u8>) {
    let bytes = bytemuck::bytes_of(message);
    let end = bytes.iter().rposition(|&byte| byte != 0).map_or(0, |last| last + 1);
    out.clear();
    out.extend_from_slice(&bytes[..end]);
}

/// Decodes a message; `None` if there are more bytes than it can have.
pub fn decode_message<T: Pod + Zeroable>(data: &[u8]) -> Option<Box<T>> {
    let mut message = bytemuck::allocation::zeroed_box::<T>();
    bytemuck::bytes_of_mut(&mut *message).get_mut(..data.len())?.copy_from_slice(data);
    Some(message)
}

/// Encodes a header and the elements after it into `out`, replacing its content.
pub fn encode_list<H: Pod, E: Pod>(header: &H, elements: &[E], out: &mut Vec<u8>) {
    out.clear();
    out.extend_from_slice(bytemuck::bytes_of(header));
    out.extend_from_slice(bytemuck::cast_slice(elements));
}

/// Decodes a header and the elements; `None` if the header or the last element is incomplete.
pub fn decode_list<H: Pod, E: Pod>(data: &[u8]) -> Option<(H, Vec<E>)> {
    let (header, elements) = data.split_at_checked(size_of::<H>())?;
    if !elements.len().is_multiple_of(size_of::<E>()) {
        return None;
    }
    let elements =
        elements.chunks_exact(size_of::<E>()).map(bytemuck::pod_read_unaligned).collect();
    Some((bytemuck::pod_read_unaligned(header), elements))
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::{Run, RunsHeader, WheelCommand};
    use proptest::prelude::*;

    #[test]
    fn zeros_at_the_end_are_left_out_and_put_back() {
        let mut bytes = Vec::new();
        encode_message(&WheelCommand { team: 1, ..Default::default() }, &mut bytes);
        assert_eq!(bytes, [1]);
        assert_eq!(decode_message::<WheelCommand>(&bytes).unwrap().team, 1);
        encode_message(&WheelCommand::default(), &mut bytes);
        assert!(bytes.is_empty());
        assert_eq!(*decode_message::<WheelCommand>(&bytes).unwrap(), WheelCommand::default());
        assert!(decode_message::<WheelCommand>(&[0; 25]).is_none());
    }

    proptest! {
        #[test]
        fn any_bytes_are_survived(data in prop::collection::vec(any::<u8>(), 0..200)) {
            if let Some((header, runs)) = decode_list::<RunsHeader, Run>(&data) {
                let mut bytes = Vec::new();
                encode_list(&header, &runs, &mut bytes);
                prop_assert_eq!(bytes, data);
            }
        }
    }
}
