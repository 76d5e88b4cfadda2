//! `antirad ambiguity`.

use crate::{Folder, names, says};

#[test]
fn what_pictures_leave_undetermined() {
    let folder = Folder::with(&[]);
    let run =
        folder.run("ambiguity room.toml --camera side --triangle 3 --triangle 150 --output out").succeeded();
    says(&run.stdout, &["views       side", "ker V", "linear programming", "determined"]);
    let report = folder.json("out/ambiguity.json");
    let count = |name: &str| report[name].as_u64().expect("a count");
    assert_eq!(count("triangles"), 200);
    assert_eq!(count("seen") + count("unseen"), 200);
    assert_eq!(count("kernel_dimension"), count("unseen"));
    assert!(count("unseen") > 10 && count("seen") > 10, "{report}");
    assert_eq!(report["intervals"].as_array().expect("intervals").len(), 2);
    let files = names(&folder.path("out"));
    let expected = [
        "ambiguity.json",
        "determination.npy",
        "intervals.csv",
        "main.png",
        "outside-1.png",
        "outside-2.png",
        "side.png",
    ];
    assert_eq!(files, expected);
    let table = String::from_utf8(folder.read("out/intervals.csv")).expect("text");
    assert_eq!(table.lines().count(), 1 + 2 * 3, "{table}");
    for line in table.lines().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        let number = |k: usize| cells[k].parse::<f64>().expect("a number");
        assert!(number(6) <= number(5) && number(5) <= number(7), "{line}");
    }
}

#[test]
fn ambiguities_that_cannot_be_examined() {
    let folder = Folder::with(&[]);
    folder
        .run("ambiguity room.toml --triangle 200 --output out")
        .refused(&["no triangle 200", "room.toml has 200"]);
    folder
        .run("ambiguity room.toml --camera nobody --output out")
        .refused(&["no camera \"nobody\"", "main, side"]);
    assert!(!folder.path("out").exists());
    // Too many unseen triangles for intervals: the rest is reported all the same.
    let run = folder.run("ambiguity room.toml --camera side --max-unseen 5 --output out").succeeded();
    says(&run.stdout, &["ker V", "left out", "--max-unseen"]);
    assert_eq!(names(&folder.path("out")), ["ambiguity.json"]);
}
