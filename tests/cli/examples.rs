//! The examples, compiled in, so that they always use the current library, whichever tests are run.

use std::process::Command;

mod embed {
    include!("../../examples/embed.rs");

    #[test]
    fn runs() {
        main().expect("the example runs");
    }
}

mod own_device {
    include!("../../examples/own_device.rs");

    #[test]
    fn runs() {
        main().expect("the example runs");
    }
}

/// Runs them again in processes of their own, where the validation layer checks an embedder's instance too, from its
/// first call to its last, and prints its messages.
#[test]
fn they_pass_validation() {
    let tests = std::env::current_exe().expect("this program");
    for example in ["embed", "own_device"] {
        let output = Command::new(&tests)
            .args(["--exact", &format!("examples::{example}::runs"), "--nocapture"])
            .env("VK_INSTANCE_LAYERS", "VK_LAYER_KHRONOS_validation")
            .output()
            .expect("a test runs");
        let said = crate::Run::from(output).succeeded().stdout;
        assert!(said.contains("1 passed") && said.contains("W/m²"), "{said}");
        assert!(!said.contains("VUID") && !said.contains("alidation"), "{said}");
    }
}
