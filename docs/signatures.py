"""What griffe, which reads the sources for the reference, cannot know of equinox and jaxtyping.

- Modules of equinox and named tuples have the `__init__` that follows from their fields.
- The second word of `Float[Array, "steps 3"]` is a shape and not the name of a type.
- What a class only implements is said once, at the abstract class that asks for it.
"""

import dataclasses

import griffe

_WITH_FIELDS = {"equinox.Module", "typing.NamedTuple"}


class Signatures(griffe.Extension):
    def on_package(self, *, pkg, **kwargs):
        del kwargs
        classes = []
        _visit(pkg, classes)
        for cls in classes:
            if _has_fields(cls) and "__init__" not in cls.members and not _is_abstract(cls):
                cls.set_member("__init__", _init(cls))
        implemented = [(cls, name) for cls in classes for name in _asked_for(cls)]
        for cls, name in implemented:
            if name in cls.members and name != "__init__":
                cls.del_member(name)


def _visit(owner, classes):
    """Mend the annotations of all that is in `owner`, and collect its classes."""
    for member in owner.members.values():
        if member.is_alias:
            continue
        if member.is_class:
            classes.append(member)
        if member.is_module or member.is_class:
            _visit(member, classes)
        elif member.is_attribute:
            _mend(member.annotation)
        elif member.is_function:
            _mend(member.returns)
            for parameter in member.parameters:
                _mend(parameter.annotation)


def _mend(expression):
    """Make the shapes of jaxtyping strings again."""
    if not isinstance(expression, griffe.Expr):
        return
    if isinstance(expression, griffe.ExprSubscript) and _is_of_jaxtyping(expression):
        elements = expression.slice.elements
        shape = str(elements[1]).strip("'\"").replace(" * ", " *")
        elements[1] = f'"{shape}"'
        return
    for field in dataclasses.fields(expression):
        value = getattr(expression, field.name)
        for part in value if isinstance(value, list | tuple) else [value]:
            if field.name != "parent":
                _mend(part)


def _is_of_jaxtyping(expression) -> bool:
    left = expression.left
    return isinstance(left, griffe.Expr) and left.canonical_path.startswith("jaxtyping.")


def _has_fields(cls) -> bool:
    paths = [base if isinstance(base, str) else base.canonical_path for base in cls.bases]
    return bool(_WITH_FIELDS & set(paths)) or any(_has_fields(base) for base in _bases(cls))


def _is_abstract(cls) -> bool:
    return any(
        "abstractmethod" in member.labels
        or (member.is_attribute and "AbstractVar" in str(member.annotation))
        for member in cls.members.values()
    )


def _bases(cls) -> list:
    return [base for base in cls.resolved_bases if base.is_class]


def _asked_for(cls) -> set[str]:
    return {name for base in _bases(cls) for name in {*base.members, *_asked_for(base)}}


def _init(cls):
    """All fields are in the class itself: the library's bases have none but abstract ones."""
    either = griffe.ParameterKind.positional_or_keyword
    parameters = [griffe.Parameter("self", kind=either)]
    for name, member in cls.members.items():
        if not member.is_attribute or member.annotation is None or "property" in member.labels:
            continue
        options, default = {}, member.value
        if isinstance(default, griffe.ExprCall) and str(default.function) == "eqx.field":
            options = {x.name: x.value for x in default.arguments}
            default = options.get("default")
        if str(options.get("init")) != "False":
            parameters.append(
                griffe.Parameter(name, annotation=member.annotation, default=default, kind=either)
            )
    return griffe.Function(
        "__init__", parent=cls, parameters=griffe.Parameters(*parameters), returns="None"
    )
