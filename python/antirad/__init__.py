from antirad._antirad import *
