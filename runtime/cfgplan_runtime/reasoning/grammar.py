"""The grammar of formulas, for lark. Operators bind in the order not, always, eventually; until; and; or; ->."""

from collections.abc import Mapping

SPELLED: Mapping[str, str] = {"G": "`always p`", "F": "`eventually p`", "U": "`p until q`"}
"""How other notations of temporal logic are written here."""

GRAMMAR = r"""
?start: implication
?implication: disjunction (IMPLIES implication)?
?disjunction: conjunction (OR conjunction)*
?conjunction: strife (AND strife)*
?strife: prefixed (UNTIL interval? strife)?
?prefixed: NOT prefixed             -> negation
         | ALWAYS interval? prefixed     -> always
         | EVENTUALLY interval? prefixed -> eventually
         | comparison
?comparison: sum (COMPARE sum)*
?sum: product ((PLUS | MINUS) product)*
?product: factor ((TIMES | OVER) factor)*
?factor: MINUS factor -> minus
       | primary
?primary: NUMBER      -> number
        | TEXT        -> text
        | TRUE        -> true
        | FALSE       -> false
        | field
        | call
        | "(" implication ")"
field: NAME (DOT_NAME | "[" INDEX "]")*
call: (NAME | IN) "(" implication ("," implication)* ")"
interval: "[" bound "," bound (RSQB | RPAR)
bound: NUMBER UNIT? | INFINITE

IMPLIES.2: "->" | "→" | "=>" | "⇒"
OR.2: /or\b|∨/
AND.2: /and\b|∧/
UNTIL.2: /until\b|𝒰/
NOT.2: /not\b|¬/
ALWAYS.2: /always\b|□/
EVENTUALLY.2: /eventually\b|◇/
IN.2: /in\b/
TRUE.2: /true\b/
FALSE.2: /false\b/
COMPARE: "<=" | ">=" | "==" | "!=" | "≤" | "≥" | "≠" | "<" | ">" | "="
PLUS: "+"
MINUS: "-"
TIMES: "*"
OVER: "/"
RSQB: "]"
RPAR: ")"
INFINITE.2: /inf\b|∞/
UNIT.2: /(ns|us|µs|ms|min|s|m|h)\b/
NUMBER: /(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?/
INDEX: /\d+/
NAME: /[^\W\d]\w*/
DOT_NAME: /\.[^\W\d]\w*/
TEXT: /"[^"\n]*"|'[^'\n]*'/
%ignore /\s+/
"""
