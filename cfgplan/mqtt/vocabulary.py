"""The small ontology of a broker: topics, kinds of values, units and areas as concepts, and the tags made of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final
from unicodedata import normalize

from cfgplan.mqtt.discovery import Entity, Path
from cfgplan.small_ontology import SmallOntology, plain_word

MQTT_NAMES: Final = "urn:cfgplan:mqtt#"
"""The prefix of the IRIs of kinds of values, units, areas and topics."""
_ROOTS: Final = {
    "Quantity": "Kinds of measurements, by Home Assistant's device classes.",
    "State": "Kinds of states. Each comes as its device says it: ON, open, true.",
    "Unit": "Units of measurement.",
    "Area": "Areas in which devices are.",
    "Topic": "Messages by their topics: those below `house/kitchen` are `house-kitchen` too.",
}
_ROLES: Final = ("inUnit", "inArea")
_ABOVE: Final = {
    "AtmosphericPressure": "Pressure",
    "GarageDoorState": "DoorState",
    "DoorState": "OpeningState",
    "WindowState": "OpeningState",
    "Pm1": "ParticulateMatter",
    "Pm25": "ParticulateMatter",
    "Pm10": "ParticulateMatter",
}
"""The superclass of some of Home Assistant's device classes."""
_UNITS: Final = {
    normalize("NFKC", sign): name
    for sign, name in {
        "°C": "DegreeCelsius",
        "°F": "DegreeFahrenheit",
        "K": "Kelvin",
        "%": "Percent",
        "lx": "Lux",
        "W": "Watt",
        "kW": "Kilowatt",
        "Wh": "WattHour",
        "kWh": "KilowattHour",
        "V": "Volt",
        "mV": "Millivolt",
        "A": "Ampere",
        "mA": "Milliampere",
        "Hz": "Hertz",
        "Pa": "Pascal",
        "hPa": "Hectopascal",
        "kPa": "Kilopascal",
        "bar": "Bar",
        "mbar": "Millibar",
        "ppm": "PartsPerMillion",
        "ppb": "PartsPerBillion",
        "µg/m³": "MicrogramPerCubicMetre",
        "mg/m³": "MilligramPerCubicMetre",
        "dB": "Decibel",
        "dBm": "DecibelMilliwatt",
        "°": "Degree",
        "m": "Metre",
        "cm": "Centimetre",
        "mm": "Millimetre",
        "km": "Kilometre",
        "m/s": "MetrePerSecond",
        "km/h": "KilometrePerHour",
        "m³": "CubicMetre",
        "m³/h": "CubicMetrePerHour",
        "L": "Litre",
        "s": "Second",
        "min": "Minute",
        "h": "Hour",
        "d": "Day",
        "g": "Gram",
        "kg": "Kilogram",
    }.items()
}
"""Signs of units and their names."""


class MqttVocabulary:
    """The concepts of entities and topics; a topic's concept is made when it is first asked for.

    Each level of a topic is below the one before: `house-kitchen-temperature` is a `house-kitchen`. Characters that
    are not allowed in names are written `_`.
    """

    def __init__(self, entities: Iterable[Entity]) -> None:
        self._ontology = SmallOntology(MQTT_NAMES, _ROOTS, _ROLES)
        self._kinds = {entity: [*self._parts(entity)] for entity in entities}

    def tag(self, topic: str, path: Path = (), entity: Entity | None = None) -> str:
        """Return the tag of a topic, or of a field of its messages; it includes kind, unit and area of a described
        entity.
        """
        return " and ".join([*(self._kinds[entity] if entity is not None else ()), self._topic(topic, path)])

    def _parts(self, entity: Entity) -> Iterator[str]:
        concept = self._ontology.concept
        if entity.kind is not None:
            root = "Quantity" if entity.is_measured else "State"
            yield self._kind(_camel(entity.kind) + ("" if entity.is_measured else root), root, entity.kind)
        if entity.unit is not None:
            sign = normalize("NFKC", entity.unit)
            yield f"inUnit some {concept(('Unit', sign), _UNITS.get(sign, plain_word(sign)), 'Unit', entity.unit)}"
        if entity.area is not None:
            yield f"inArea some {concept(('Area', entity.area), _camel(entity.area), 'Area', entity.area)}"

    def _kind(self, word: str, root: str, label: str) -> str:
        above = self._kind(_ABOVE[word], root, _ABOVE[word]) if word in _ABOVE else root
        return self._ontology.concept((root, word), word, above, label)

    def _topic(self, name: str, path: Path) -> str:
        levels, steps = name.split("/"), [*map(str, path)]
        key: tuple[str, ...] = ("Topic",)
        above, words = "Topic", [""]
        for number, part in enumerate([*levels, *steps]):
            key = (*key, part) if number < len(levels) else (*key, "", part)  # no topic but a field has such a key
            words.append(plain_word(part))
            if not any(words) and number + 1 < len(levels):
                continue  # leading slashes have no concept of their own
            label = " ".join(["/".join(levels[: number + 1]), *steps[: max(number + 1 - len(levels), 0)]])
            above = self._ontology.concept(key, "-".join(filter(None, words)) or "_", above, label)
        return above

    @property
    def text(self) -> str:
        """The ontology in Turtle."""
        return self._ontology.text


def _camel(text: str) -> str:
    return "".join(part[:1].upper() + part[1:] for part in plain_word(text).split("_"))
