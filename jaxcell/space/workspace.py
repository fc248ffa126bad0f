import dataclasses
class Workspace: pass
