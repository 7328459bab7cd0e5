"""Type support of packages that have no wheel, made with rosidl's own generators and gcc.

``python typesupport.py OUTPUT PACKAGE...`` in ROS 2's own interpreter; a package comes after those that it
uses. OUTPUT/python then contains what rclpy imports. Libraries contain their path: build again instead of moving.
"""

import os
import subprocess
import sys
import sysconfig
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

os.environ["AMENT_PREFIX_PATH"] = sys.prefix

import numpy as np
from rosidl_adapter.cli import TranslateActionToIDL, TranslateMsgToIDL, TranslateSrvToIDL
from rosidl_generator_c.cli import GenerateC
from rosidl_generator_py.cli import GeneratePython
from rosidl_generator_type_description.cli import HashTypeDescription
from rosidl_typesupport_c.cli import GenerateCTypesupport
from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport

SUFFIX = sysconfig.get_config_var("EXT_SUFFIX")
TRANSLATORS = {"msg": TranslateMsgToIDL, "srv": TranslateSrvToIDL, "action": TranslateActionToIDL}
# One folder each: two of them write files of one name.
GENERATORS = {
    "generator_c": GenerateC("c"),
    "typesupport_introspection_c": GenerateIntrospectionCTypesupport("introspection_c"),
    "typesupport_fastrtps_c": GenerateFastRTPSCTypesupport("fastrtps_c"),
    "typesupport_c": GenerateCTypesupport(
        "c",
        typesupport_implementations=[
            "rosidl_typesupport_introspection_c",
            "rosidl_typesupport_fastrtps_c",
        ],
    ),
    "generator_py": GeneratePython("py", typesupport_implementations=["rosidl_typesupport_c"]),
}
RUNTIME = [
    "rosidl_runtime_c",
    *(
        f"rosidl_typesupport_{kind}"
        for kind in ("c", "introspection_c", "fastrtps_c", "fastrtps_cpp")
    ),
    *("fastcdr", "rcutils", "rmw"),
]


def sources(out, package):
    """Write a package's generated files below `out`, a folder a generator."""
    share = out / "share" / package.name
    for kind, translator in TRANSLATORS.items():
        if files := [
            f"{package}:{file.relative_to(package)}"
            for file in sorted(package.glob(f"{kind}/*.{kind}"))
        ]:
            translator(kind).translate(package.name, files, [], share)
    idl = [f"{share}:{file.relative_to(share)}" for file in sorted(share.rglob("*.idl"))]
    paths = [f"{sys.prefix}/share", str(out / "share")]
    hashes = HashTypeDescription("hash").generate_type_hashes(package.name, idl, paths, share)
    for name, generator in GENERATORS.items():
        more = {"type_description_files": hashes} if name == "generator_c" else {}
        generator.generate(package.name, idl, paths, output_path=out / name / package.name, **more)


def linked(out, package):
    """Return the libraries that a package is linked to: what it may use, whether it does or not."""
    folders = (out / "python" / package.name, *(out / "python").iterdir(), Path(sys.prefix, "lib"))
    found = {}
    for folder in folders:
        for name in GENERATORS:
            for file in folder.glob(f"lib*__rosidl_{name}.so"):
                found.setdefault(file.name, file)
    return [str(file) for file in found.values()]


def compiled(out, file):
    """Compile a file, and return its object's path."""
    target = file.with_suffix(file.suffix + ".o")
    folders = [*(out / name for name in GENERATORS), *Path(sys.prefix, "include").iterdir()]
    folders += [
        Path(sysconfig.get_path("include")),
        Path(np.get_include()),
        Path(sys.prefix, "include"),
    ]
    compiler = ["g++", "-std=c++17"] if file.suffix == ".cpp" else ["gcc", "-std=c11"]
    includes = [f"-I{folder}" for folder in folders]
    subprocess.run([*compiler, "-fPIC", "-w", "-c", file, "-o", target, *includes], check=True)
    return target


def link(out, package, target, objects):
    """Link a library of a package."""
    lib = f"{sys.prefix}/lib"
    others = [each for each in linked(out, package) if each != str(target)]
    libraries = [f"-L{lib}", *(f"-l{name}" for name in RUNTIME), f"-Wl,-rpath,{lib}:$ORIGIN"]
    libraries += [f"-Wl,-rpath,{folder}" for folder in (out / "python").iterdir()]
    argv = [
        "g++",
        "-shared",
        f"-Wl,-soname,{target.name}",
        "-o",
        target,
        *objects,
        "-Wl,--no-as-needed",
    ]
    subprocess.run([*argv, *others, *libraries], check=True)


def build(out, package):
    """Make what rclpy needs of a package."""
    sources(out, package)
    python = out / "python" / package.name
    python.mkdir(parents=True)
    files = {name: sorted((out / name / package.name).rglob("*.c*")) for name in GENERATORS}
    entries = [f for f in files["generator_py"] if ".ep." in f.name]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        every = {f: pool.submit(compiled, out, f) for each in files.values() for f in each}
        for name, each in files.items():
            objects = [every[f].result() for f in each if f not in entries]
            link(out, package, python / f"lib{package.name}__rosidl_{name}.so", objects)
    for entry in entries:
        link(
            out,
            package,
            python / f"{package.name}_s__rosidl_typesupport_c{SUFFIX}",
            [every[entry].result()],
        )
    made = out / "generator_py" / package.name
    for file in made.rglob("*.py"):
        (python / file.relative_to(made)).parent.mkdir(exist_ok=True)
        file.rename(python / file.relative_to(made))
    (python / "__init__.py").touch()


for path in sys.argv[2:]:
    build(Path(sys.argv[1]).resolve(), Path(path).resolve())
