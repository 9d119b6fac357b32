"""Reference figures of the search: Sobol points of SciPy, and the regret of Optuna's tree-structured Parzen estimator.

    pip install scipy==1.17.1 optuna==5.0.0
    python search_reference.py points > sobol.csv
    python search_reference.py regret > regret.csv

The regret of a search is its best value after 50 trials minus the minimum of the function. regret.csv holds its mean
and standard error over seeds 0 to 99, run one trial at a time with the default settings of the sampler.
"""

import math
import sys


def points():
    from scipy.stats import qmc

    print("point,dimension,value")
    for i, row in enumerate(qmc.Sobol(40, scramble=False, bits=32).random(64)):
        for k, x in enumerate(row):
            print(f"{i},{k},{x!r}".replace("np.float64(", "").replace(")", ""))


def branin(x, y):
    """Dixon and Szego 1978; minimum 0.397887."""
    b, c, t = 5.1 / (4 * math.pi**2), 5 / math.pi, 1 / (8 * math.pi)
    return (y - b * x**2 + c * x - 6) ** 2 + 10 * (1 - t) * math.cos(x) + 10


def regret():
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    functions = {
        "branin": (lambda t: branin(t.suggest_float("x", -5, 10), t.suggest_float("y", 0, 15)), 0.39788735772973816),
        "quadratic": (
            lambda t: sum((t.suggest_float(f"x{k}", -5, 5) - (k - 1)) ** 2 for k in range(3)),
            0.0,
        ),
        "mixed": (
            lambda t: (math.log10(t.suggest_float("rate", 1e-6, 1, log=True)) + 3) ** 2
            + ((t.suggest_int("count", 1, 40) - 13) / 8) ** 2
            + {"a": 2.0, "b": 0.0, "c": 1.0}[t.suggest_categorical("kind", ["a", "b", "c"])],
            0.0,
        ),
    }
    samplers = {
        "optuna_tpe": lambda s: optuna.samplers.TPESampler(seed=s),
        "optuna_random": lambda s: optuna.samplers.RandomSampler(seed=s),
    }
    print("function,sampler,mean,standard_error")
    for name, (f, least) in functions.items():
        for sampler, made in samplers.items():
            found = []
            for seed in range(100):
                study = optuna.create_study(sampler=made(seed))
                study.optimize(f, n_trials=50)
                found.append(study.best_value - least)
            mean = sum(found) / len(found)
            error = math.sqrt(sum((x - mean) ** 2 for x in found) / (len(found) - 1) / len(found))
            print(f"{name},{sampler},{mean:.6f},{error:.6f}", flush=True)


if __name__ == "__main__":
    {"points": points, "regret": regret}[sys.argv[1]]()
