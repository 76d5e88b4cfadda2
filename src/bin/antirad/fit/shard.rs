//! The jobs of a batch that one of several processes does.

use std::fmt;
use std::str::FromStr;

/// Part `index` (from 1) of `count`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    index: usize,
    count: usize,
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |text: &str| text.parse::<usize>().ok();
        let parts = text.split_once('/').and_then(|(index, count)| Some((number(index)?, number(count)?)));
        match parts {
            Some((index, count)) if (1..=count).contains(&index) => Ok(Self { index, count }),
            _ => Err(String::from("expected K/N with K from 1 to N, such as 2/8")),
        }
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

impl Shard {
    /// The shard of this task of a Slurm array or of an indexed Job of Kubernetes; `None` outside of both.
    /// `variable` reads the environment.
    pub fn of_environment(variable: impl Fn(&str) -> Option<String>) -> Result<Option<Self>, String> {
        let number = |name: &str| -> Result<Option<usize>, String> {
            let Some(text) = variable(name) else { return Ok(None) };
            let wrong = |_| format!("{name}={text} is not a number; give --shard K/N");
            text.trim().parse().map(Some).map_err(wrong)
        };
        if let Some(task) = number("SLURM_ARRAY_TASK_ID")? {
            let get = |name| number(name)?.ok_or_else(|| format!("{name} is not set; give --shard K/N"));
            let (least, count) = (get("SLURM_ARRAY_TASK_MIN")?, get("SLURM_ARRAY_TASK_COUNT")?);
            let step = number("SLURM_ARRAY_TASK_STEP")?.unwrap_or(1).max(1);
            // An array may be a list of any numbers, whose place in it Slurm does not tell.
            let index = task.checked_sub(least).filter(|way| way % step == 0).map(|way| way / step);
            return match index.filter(|index| *index < count) {
                Some(index) => Ok(Some(Self { index: index + 1, count })),
                None => Err(format!(
                    "task {task} of a Slurm array of {count} tasks from {least} with step {step}: number tasks \
                     without gaps (--array=1-{count}), or give --shard K/N"
                )),
            };
        }
        let Some(index) = number("JOB_COMPLETION_INDEX")? else { return Ok(None) };
        match number(COUNT)? {
            Some(count) if index < count => Ok(Some(Self { index: index + 1, count })),
            Some(count) => Err(format!("JOB_COMPLETION_INDEX={index} is not below {COUNT}={count}")),
            None => Err(format!(
                "JOB_COMPLETION_INDEX={index}, but of how many? Set {COUNT} to the Job's completions, or give --shard K/N"
            )),
        }
    }

    /// Every `count`th item: the same on every machine that sees the same list.
    pub fn choose<T>(self, all: Vec<T>) -> Vec<T> {
        all.into_iter().skip(self.index - 1).step_by(self.count).collect()
    }
}

/// The number of completions of an indexed Job, which Kubernetes does not tell its pods.
const COUNT: &str = "ANTIRAD_SHARDS";

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashMap;

    fn of(variables: &[(&str, &str)]) -> Result<Option<Shard>, String> {
        let variables: HashMap<&str, &str> = variables.iter().copied().collect();
        Shard::of_environment(|name| variables.get(name).map(|text| (*text).to_owned()))
    }

    #[test]
    fn every_job_is_in_one_shard() {
        for count in 1..9 {
            let mut all: Vec<usize> = (1..=count)
                .flat_map(|index| {
                    let part = Shard { index, count }.choose((0..40).collect());
                    assert!(part.len() >= 40 / count && part.len() <= 40 / count + 1);
                    part
                })
                .collect();
            all.sort_unstable();
            assert_eq!(all, (0..40).collect::<Vec<_>>());
        }
        assert!(Shard { index: 5, count: 9 }.choose(vec![1, 2]).is_empty());
    }

    #[test]
    fn what_people_write() {
        assert_eq!("2/8".parse(), Ok(Shard { index: 2, count: 8 }));
        for text in ["", "2", "0/8", "9/8", "1/0", "a/b", "1/2/3", "-1/2"] {
            assert!(text.parse::<Shard>().is_err(), "{text}");
        }
    }

    #[test]
    fn what_schedulers_say() {
        let slurm = |id, min, count, step| {
            of(&[
                ("SLURM_ARRAY_TASK_ID", id),
                ("SLURM_ARRAY_TASK_MIN", min),
                ("SLURM_ARRAY_TASK_COUNT", count),
                ("SLURM_ARRAY_TASK_STEP", step),
            ])
        };
        assert_eq!(slurm("1", "1", "40", "1"), Ok(Some(Shard { index: 1, count: 40 })));
        assert_eq!(slurm("39", "0", "40", "1"), Ok(Some(Shard { index: 40, count: 40 })));
        assert_eq!(slurm("12", "4", "5", "4"), Ok(Some(Shard { index: 3, count: 5 })));
        for wrong in [slurm("7", "1", "3", "1"), slurm("5", "4", "5", "4"), slurm("x", "1", "3", "1")] {
            assert!(wrong.expect_err("no place").contains("--shard K/N"));
        }
        assert!(of(&[("SLURM_ARRAY_TASK_ID", "1")]).expect_err("no count").contains("SLURM_ARRAY_TASK_MIN"));
        let indexed = of(&[("JOB_COMPLETION_INDEX", "0"), ("ANTIRAD_SHARDS", "4")]);
        assert_eq!(indexed, Ok(Some(Shard { index: 1, count: 4 })));
        assert!(of(&[("JOB_COMPLETION_INDEX", "4"), ("ANTIRAD_SHARDS", "4")]).is_err());
        assert!(of(&[("JOB_COMPLETION_INDEX", "4")]).expect_err("no count").contains("ANTIRAD_SHARDS"));
        assert_eq!(of(&[("ANTIRAD_SHARDS", "4")]), Ok(None));
    }
}
