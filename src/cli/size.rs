//! Sizes in bytes, as people write them.

/// "96MiB", "1GiB", "1.5 GB", "1048576": bytes.
pub fn parse_size(text: &str) -> Result<u64, String> {
    let text = text.trim();
    let digits = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    let factor = match unit.trim().to_ascii_lowercase().as_str() {
        "" | "b" => 1.0,
        "kib" | "k" => 1024.0,
        "mib" | "m" => 1024.0 * 1024.0,
        "gib" | "g" => 1024.0 * 1024.0 * 1024.0,
        "kb" => 1e3,
        "mb" => 1e6,
        "gb" => 1e9,
        _ => return Err(format!("unknown unit \"{}\": use KiB, MiB, GiB, kB, MB or GB", unit.trim())),
    };
    match number.parse::<f64>() {
        Ok(number) if number * factor >= u64::MAX as f64 => Err(format!(
            "\"{text}\" is more than a computer can address: write 96MiB, 1.5GiB or a number of bytes"
        )),
        Ok(number) if number.is_finite() => Ok((number * factor) as u64),
        _ => Err(format!("\"{text}\" is not a size: write 96MiB, 1.5GiB or a number of bytes")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_as_people_write_them() {
        for (text, bytes) in
            [("96MiB", 96 << 20), ("1.5GiB", 3 << 29), ("2 gb", 2_000_000_000), ("77", 77), ("0", 0)]
        {
            assert_eq!(parse_size(text), Ok(bytes), "{text}");
        }
        for text in ["", "MiB", "1 parsec", "1..2GiB", "-5", "1e20GiB", "100000000000000000000GiB"] {
            assert!(parse_size(text).is_err(), "{text}");
        }
    }
}
