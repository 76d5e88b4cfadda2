//! Sizes in bytes, with units.

use bytesize::ByteSize;

/// "96MiB", "1GiB", "1.5 GB", "1048576": bytes.
pub fn parse_size(text: &str) -> Result<u64, String> {
    let hint = "write 96MiB, 1.5GiB, 2GB or a number of bytes";
    match text.trim().parse() {
        // Larger sizes saturate.
        Ok(ByteSize(u64::MAX)) => Err(format!("\"{text}\" is more than any device has; {hint}")),
        Ok(ByteSize(bytes)) => Ok(bytes),
        Err(_) => Err(format!("\"{text}\" is not a size; {hint}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_as_people_write_them() {
        for (text, bytes) in
            [("96MiB", 96 << 20), ("1.5GiB", 3 << 29), ("2 gb", 2_000_000_000), (" 77 ", 77), ("0", 0)]
        {
            assert_eq!(parse_size(text), Ok(bytes), "{text}");
        }
        for text in ["", "MiB", "1 parsec", "1..2GiB", "-5", "inf", "nan GiB", "1e20GiB"] {
            let message = parse_size(text).expect_err(text);
            assert!(message.contains("is not a size") && message.contains("MiB"), "{message}");
        }
        for text in ["99999999999999999999999", "100000000000000000000GiB", "17179869184.5GiB"] {
            parse_size(text).expect_err(text);
        }
    }
}
